"""Coding of tables: round trips, limits, and refusal of what does not fit."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from codecbench.plugins.codecs.multilevel.arithmetic import UNWRITTEN
from codecbench.plugins.codecs.multilevel.tables import (
    BAD_COUNTS,
    OUT_OF_RANGE,
    decode_codes,
    decode_tuples,
    encode_codes,
    encode_tuples,
)

ROOM = 1 << 16


def table(rng: np.random.Generator, radix: int, group: int, size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    keys = radix ** np.arange(group, dtype=np.int64)
    codes = np.unique(rng.integers(0, radix**group, size))
    tuples = (codes[:, None] // keys % radix).astype(np.int32)
    counts = 1 + rng.geometric(0.3, len(codes)).astype(np.int64) ** 3
    return codes, tuples, counts


@given(st.integers(1, 300), st.integers(2, 5), st.integers(1, 200), st.booleans(), st.integers(0, 10**6))
@settings(max_examples=120)
def test_tables_come_back(radix: int, group: int, size: int, top: bool, seed: int) -> None:
    codes, tuples, counts = table(np.random.default_rng(seed), radix, group, size)
    total = int(counts.sum())
    sent = counts if top else counts[:0]
    out = np.empty(ROOM, np.uint8)
    back, back_counts = np.empty_like(tuples), np.empty_like(sent)
    length = encode_tuples(tuples, sent, out)
    assert decode_tuples(out[:length], radix, total, back, back_counts) == length + UNWRITTEN
    assert np.array_equal(back, tuples)
    assert np.array_equal(back_counts, sent)
    back_codes, back_counts = np.empty_like(codes), np.empty_like(sent)
    length = encode_codes(codes, sent, out)
    assert decode_codes(out[:length], radix**group - 1, total, back_codes, back_counts) == length + UNWRITTEN
    assert np.array_equal(back_codes, codes)
    assert np.array_equal(back_counts, sent)


def test_codes_of_62_bits_come_back() -> None:
    codes = np.array([0, 1, 2**40, 2**62 - 1], np.int64)
    counts = np.array([1, 2**26, 1, 7], np.int64)
    out = np.empty(ROOM, np.uint8)
    length = encode_codes(codes, counts, out)
    back, back_counts = np.empty_like(codes), np.empty_like(counts)
    assert decode_codes(out[:length], 2**62 - 1, int(counts.sum()), back, back_counts) == length + UNWRITTEN
    assert np.array_equal(back, codes)
    assert np.array_equal(back_counts, counts)


def test_what_does_not_fit_is_refused(rng: np.random.Generator) -> None:
    codes, tuples, counts = table(rng, 50, 3, 100)
    total = int(counts.sum())
    out = np.empty(ROOM, np.uint8)
    data = out[: encode_tuples(tuples, counts, out)].copy()
    assert decode_tuples(data, int(tuples.max()), total, np.empty_like(tuples), np.empty_like(counts)) == OUT_OF_RANGE
    for wrong in (total - 1, total + 1):
        assert decode_tuples(data, 50, wrong, np.empty_like(tuples), np.empty_like(counts)) == BAD_COUNTS
    data = out[: encode_codes(codes, counts, out)].copy()
    assert decode_codes(data, int(codes[-1]) - 1, total, np.empty_like(codes), np.empty_like(counts)) == OUT_OF_RANGE
    assert decode_codes(data, int(codes[-1]), total + 1, np.empty_like(codes), np.empty_like(counts)) == BAD_COUNTS


def test_too_little_room_is_said_not_overrun(rng: np.random.Generator) -> None:
    codes, tuples, counts = table(rng, 50, 3, 2000)
    buffer = np.zeros(4096, np.uint8)
    assert encode_tuples(tuples, counts, buffer[:2000]) == -1
    assert encode_codes(codes, counts, buffer[:2000]) == -1
    assert not buffer[2000:].any()


def test_any_bytes_decode_to_digits_in_range(rng: np.random.Generator) -> None:
    for _ in range(300):
        data = rng.integers(0, 256, rng.integers(0, 120)).astype(np.uint8)
        tuples, counts = np.empty((40, 3), np.int32), np.empty(40, np.int64)
        if decode_tuples(data, 9, 5000, tuples, counts) >= 0:
            assert tuples.min() >= 0
            assert tuples.max() < 9
            assert counts.sum() == 5000
