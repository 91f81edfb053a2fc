"""Binary decisions: tables against their formulas, round trips, and how close to the entropy they come."""

from __future__ import annotations

import math

import numpy as np
import pytest

from codecbench.plugins.codecs.multilevel.arithmetic import UNWRITTEN
from codecbench.plugins.codecs.multilevel.context import binary
from codecbench.plugins.codecs.multilevel.context.binary import (
    LOG_ODDS,
    POSITION,
    PROBABILITIES,
    TOO_LARGE,
    UNARY_LENGTH,
    code_adaptive,
    code_bit,
    code_mixed,
    code_number,
    finish,
    new_coder,
    probabilities_from_odds,
    start_decoding,
)

UNSEEN = 1 << 29
CONTEXTS = 64


class Coder:
    """The arrays of a coder, with a model that has seen nothing."""

    def __init__(self, data: np.ndarray | None = None, mixing: bool = True) -> None:
        self.coder = new_coder(mixing, 1 << 40)
        self.data = np.empty(1 << 16, np.uint8) if data is None else data
        if data is not None:
            start_decoding(self.coder, self.data)
        self.model = np.full(CONTEXTS, UNSEEN, np.int32)
        self.weights = np.full((32, 3), 26214, np.int32)

    def arrays(self) -> tuple[np.ndarray, ...]:
        return self.coder, self.data, self.model, self.weights

    def written(self) -> np.ndarray:
        return self.data[: finish(self.coder, self.data)].copy()


def test_probabilities_are_logistic() -> None:
    odds = -16 + (np.arange(4096) + 0.5) / 128
    expected = np.clip(65536 / (1 + np.exp(-odds)), 24, 65512)
    assert np.abs(PROBABILITIES - expected).max() <= 1
    assert np.array_equal(PROBABILITIES, 65536 - PROBABILITIES[::-1])


def test_log_odds_are_the_inverse() -> None:
    share = (np.arange(4096) + 0.5) / 4096
    assert np.abs(LOG_ODDS / 1024 - np.log(share / (1 - share))).max() < 1.1 / 1024


def test_priors_odds_become_probabilities() -> None:
    odds = np.arange(-127, 128)
    expected = 2**22 / (1 + np.exp(-odds / 16))
    assert np.abs(probabilities_from_odds(odds) - expected).max() <= 2


@pytest.mark.parametrize("mixing", [True, False])
@pytest.mark.parametrize("share", [0.003, 0.2, 0.5, 0.9])
def test_bits_come_back_near_their_entropy(share: float, mixing: bool) -> None:
    bits = (np.random.default_rng(8).random(40_000) < share).astype(int)
    coder = Coder(mixing=mixing)
    for bit in bits:
        code_mixed(*coder.arrays(), 0, 1, 2, 3, bit)
    data = coder.written()
    entropy = -(share * math.log2(share) + (1 - share) * math.log2(1 - share)) * len(bits) / 8
    assert entropy * 0.9 < len(data) < entropy * 1.03 + 20
    decoder = Coder(data, mixing)
    assert [code_mixed(*decoder.arrays(), 0, 1, 2, 3, 0) for _ in bits] == bits.tolist()
    assert decoder.coder[POSITION] == len(data) + UNWRITTEN


def test_the_context_that_knows_gets_the_weight() -> None:
    """One of three contexts tells the bit; the mix learns which, and codes it for next to nothing."""
    bits = np.random.default_rng(3).integers(0, 2, 20_000)
    coder = Coder()
    for bit in bits:
        code_mixed(*coder.arrays(), 0, 1, 2, 4 + bit, bit)
    assert len(coder.written()) < 0.02 * len(bits) / 8
    assert coder.weights[0, 2] > 2 * abs(coder.weights[0, 0])


def test_numbers_of_any_size_come_back() -> None:
    numbers = [0, 1, 5, UNARY_LENGTH - 1, UNARY_LENGTH, UNARY_LENGTH + 1, 100, 4000, 131_000]
    coder = Coder()
    for number in numbers:
        code_number(*coder.arrays(), 0, 0, 15, 30, number)
    decoder = Coder(coder.written())
    assert [code_number(*decoder.arrays(), 0, 0, 15, 30, 0) for _ in numbers] == numbers


def test_a_number_longer_than_any_is_refused() -> None:
    decoder = Coder(np.zeros(400, np.uint8))  # zeros decode as ones without end
    assert code_number(*decoder.arrays(), 0, 0, 15, 30, 0) == TOO_LARGE


def test_a_single_context_adapts() -> None:
    coder = Coder()
    for _ in range(100):
        code_adaptive(coder.coder, coder.data, coder.model, 7, 1)
    assert coder.model[7] >> 8 > 0.98 * 2**22
    assert coder.model[7] & 255 == 100
    assert (coder.model[np.arange(CONTEXTS) != 7] == UNSEEN).all()


def test_even_bits_cost_a_bit() -> None:
    coder = Coder()
    for bit in np.random.default_rng(1).integers(0, 2, 8000):
        code_bit(coder.coder, coder.data, 1 << 15, bit)
    assert len(coder.written()) in (1001, 1002)


def test_no_context_ever_leaves_its_bits() -> None:
    model = np.full(1, UNSEEN, np.int32)
    for bit in (1, 0):
        for _ in range(20_000):
            binary._adapt(model, 0, bit)
        assert 0 <= model[0] >> 8 <= 2**22
