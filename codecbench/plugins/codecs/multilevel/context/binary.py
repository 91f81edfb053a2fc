"""Binary decisions coded by adaptive probabilities, of one context or mixed from three, and numbers of such decisions.

The same functions encode and decode. Four arrays are the state of a coder; functions take all of them:

- `coder` (6,) int64: LOW (encoding) or code (decoding), WIDTH, POSITION, ENCODING, MIXING, LIMIT;
- `data` uint8: the bytes written or read;
- `model` (contexts,) int32: P(bit = 1) in 1/2^22 times 2^8, plus the number of bits seen, up to MAX_SEEN;
- `weights` (sets, 3) int32: weights of the three contexts' log odds, in 1/2^16.

Kernels that are called for every decision are compiled without reference counts (`_nrt`), which would take longer than
the arithmetic.

Source of the mixing: Mahoney, "Adaptive weighing of context models for lossless data compression" (2005). The tables
are computed from integers, so that rounding does not differ between machines.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.multilevel.arithmetic import (
    LOOK_AHEAD,
    TOP,
    decode_interval,
    encode_interval,
    finish_encoder,
    first_code,
)

LOW, WIDTH, POSITION, ENCODING, MIXING, LIMIT = range(6)

MAX_SEEN = 160
PROBABILITY_BITS, SEEN_BITS = 22, 8

UNARY_LENGTH = 14
_MAX_EXPONENT = 17
TOO_LARGE = -1
"""Result for a number whose code is longer than any encoder's."""

_RAW = 1 << 15
_LEARNING_RATE = 3
_LEARNING_SHIFT = 18
_ODDS_PER_NAT = 1024
_FINE_STEPS = 16 * _ODDS_PER_NAT


def _logistic() -> NDArray[np.int64]:
    """Return 1 / (1 + e^-x) in 1/2^32 for x = 0, 1/1024, ..., 16: powers of e^(-1/1024) in 64 fractional bits."""
    step = 18428738468430479223
    power, values = 1 << 64, []
    for _ in range(_FINE_STEPS + 1):
        values.append((1 << 96) // ((1 << 64) + power))
        power = power * step >> 64
    return np.array(values, np.int64)


def _probabilities(logistic: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return P(bit = 1) in 1/2^16 of log odds -16 + (i + 1/2) / 128, at least 24 / 2^16 away from 0 and 1."""
    upper = logistic[4:_FINE_STEPS:8] + (1 << 15) >> 16
    return np.asarray(np.clip(np.concatenate([65536 - upper[::-1], upper]), 24, 65512), np.int32)


def _log_odds(logistic: NDArray[np.int64]) -> NDArray[np.int32]:
    """Return ln(p / (1 - p)) in 1/1024 of p = (i + 1/2) / 4096."""
    upper = np.searchsorted(logistic, (2 * np.arange(2048, 4096) + 1) << 19)
    return np.concatenate([-upper[::-1], upper]).astype(np.int32)


_LOGISTIC = _logistic()
PROBABILITIES = _probabilities(_LOGISTIC)
LOG_ODDS = _log_odds(_LOGISTIC)
RATES = np.array([655360 // (10 * seen + 16) for seen in range(MAX_SEEN + 1)], np.int32)
"""Learning rate of a context by the number of bits seen, in 1/2^16: 1 / (seen + 1.6)."""


def new_coder(mixing: bool, limit: int) -> NDArray[np.int64]:
    """Make an encoding coder. limit: upper bound of the position."""
    coder = np.zeros(6, np.int64)
    coder[[WIDTH, ENCODING, MIXING, LIMIT]] = TOP - 1, 1, mixing, limit
    return coder


def probabilities_from_odds(odds: NDArray[np.int64]) -> NDArray[np.int64]:
    """Convert log odds in 1/16 to P(bit = 1) in 1/2^22."""
    upper = _LOGISTIC[64 * np.abs(odds)] >> (32 - PROBABILITY_BITS)
    return np.asarray(np.where(odds < 0, (1 << PROBABILITY_BITS) - upper, upper), np.int64)


@kernel(_nrt=False)
def start_decoding(coder: Any, data: Any) -> None:
    """Read the first code; the coder decodes from then on."""
    coder[LOW] = first_code(data)
    coder[WIDTH] = TOP - 1
    coder[POSITION] = LOOK_AHEAD
    coder[ENCODING] = 0


@kernel(_nrt=False, forceinline=True)
def code_bit(coder: Any, data: Any, probability: Any, bit: Any) -> Any:
    """Code `bit`, or decode and return it. probability: P(bit = 1) in 1/2^16, above 0 and below 1."""
    width = coder[WIDTH]
    split = (width >> 16) * probability
    if coder[ENCODING]:
        start = 0 if bit else split
        count = split if bit else width - split
        coder[LOW], coder[WIDTH], coder[POSITION] = encode_interval(
            coder[LOW], width, coder[POSITION], data, start, count, 1
        )
        return bit
    bit = 1 if coder[LOW] < split else 0
    start = 0 if bit else split
    count = split if bit else width - split
    coder[LOW], coder[WIDTH], coder[POSITION] = decode_interval(coder[LOW], coder[POSITION], data, start, count, 1)
    return bit


@kernel(_nrt=False, forceinline=True)
def _adapt(model: Any, context: Any, bit: Any) -> None:
    state = np.int64(model[context])
    seen = state & 255
    probability = state >> 8
    probability += (((bit << 22) - probability) * RATES[seen]) >> 16
    model[context] = (probability << 8) | min(seen + 1, MAX_SEEN)


@kernel(_nrt=False, forceinline=True)
def code_adaptive(coder: Any, data: Any, model: Any, context: Any, bit: Any) -> Any:
    """Code or decode a bit by one context."""
    probability = min(max(model[context] >> 14, 24), 65512)
    bit = code_bit(coder, data, probability, bit)
    _adapt(model, context, bit)
    return bit


@kernel(_nrt=False)
def code_mixed(
    coder: Any, data: Any, model: Any, weights: Any, chosen: Any, first: Any, second: Any, third: Any, bit: Any
) -> Any:
    """Code or decode a bit by three contexts with the weights of set `chosen`; without mixing, by the second only."""
    if not coder[MIXING]:
        return code_adaptive(coder, data, model, second, bit)
    odds_1 = np.int64(LOG_ODDS[model[first] >> 18])
    odds_2 = np.int64(LOG_ODDS[model[second] >> 18])
    odds_3 = np.int64(LOG_ODDS[model[third] >> 18])
    total = weights[chosen, 0] * odds_1 + weights[chosen, 1] * odds_2 + weights[chosen, 2] * odds_3
    probability = np.int64(PROBABILITIES[min(max((total >> 19) + 2048, 0), 4095)])
    bit = code_bit(coder, data, probability, bit)
    surprise = ((bit << 16) - probability) * _LEARNING_RATE
    half = 1 << (_LEARNING_SHIFT - 1)
    weights[chosen, 0] += (surprise * odds_1 + half) >> _LEARNING_SHIFT
    weights[chosen, 1] += (surprise * odds_2 + half) >> _LEARNING_SHIFT
    weights[chosen, 2] += (surprise * odds_3 + half) >> _LEARNING_SHIFT
    _adapt(model, first, bit)
    _adapt(model, second, bit)
    _adapt(model, third, bit)
    return bit


@kernel(_nrt=False)
def code_number(
    coder: Any, data: Any, model: Any, weights: Any, chosen: Any, first: Any, second: Any, third: Any, number: Any
) -> Any:
    """Code or decode a number of 0 or more, or return TOO_LARGE.

    The code is unary, each bit with its own contexts and set of weights; from UNARY_LENGTH on it is an exponential
    Golomb code of equally likely bits.
    """
    count = 0
    while count < UNARY_LENGTH:
        more = 1 if number > count else 0
        if not code_mixed(
            coder, data, model, weights, chosen + count, first + count, second + count, third + count, more
        ):
            return count
        count += 1
    rest = number - UNARY_LENGTH + 1
    exponent = 0
    while code_bit(coder, data, _RAW, 1 if rest >> (exponent + 1) > 0 else 0):
        exponent += 1
        if exponent > _MAX_EXPONENT:
            return TOO_LARGE
    value = 1
    for place in range(exponent - 1, -1, -1):
        value = (value << 1) | code_bit(coder, data, _RAW, (rest >> place) & 1)
    return value - 1 + UNARY_LENGTH


@kernel(_nrt=False)
def finish(coder: Any, data: Any) -> Any:
    """Write the last bytes; returns the length of the output."""
    return finish_encoder(coder[LOW], coder[POSITION], data)
