"""Tables by Rice codes: round trips, limits, refusal, and what `effort: fast` asks for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from multilevel_pictures import textured
from pydantic import ValidationError

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.counting.trace import CountingTrace
from codecbench.plugins.codecs.multilevel import Multilevel, MultilevelParams, describe
from codecbench.plugins.codecs.multilevel.arithmetic import UNWRITTEN
from codecbench.plugins.codecs.multilevel.bitstream import pack, unpack
from codecbench.plugins.codecs.multilevel.header import RICE_VERSION
from codecbench.plugins.codecs.multilevel.rice import decode_ordered_tuples, encode_ordered_tuples
from codecbench.plugins.codecs.multilevel.tables import BAD_COUNTS, OUT_OF_RANGE, OVERRUN

ROOM = 1 << 16
RADIX = 50


def table(rng: np.random.Generator, radix: int, group: int, size: int) -> tuple[np.ndarray, np.ndarray]:
    codes = np.unique(rng.integers(0, radix**group, size))
    tuples = (codes[:, None] // radix ** np.arange(group, dtype=np.int64) % radix).astype(np.int32)
    return tuples, 1 + rng.geometric(0.3, len(codes)).astype(np.int64) ** 3


def coded(tuples: np.ndarray, counts: np.ndarray, usual: int) -> np.ndarray:
    out = np.empty(ROOM, np.uint8)
    return out[: encode_ordered_tuples(tuples, counts, usual, out)].copy()


@given(
    st.integers(1, 300),
    st.integers(2, 5),
    st.integers(1, 200),
    st.booleans(),
    st.floats(0, 0.99),
    st.integers(0, 10**6),
)
@settings(max_examples=120)
def test_tables_come_back(radix: int, group: int, size: int, top: bool, usual: float, seed: int) -> None:
    tuples, counts = table(np.random.default_rng(seed), radix, group, size)
    sent, total, digit = counts if top else counts[:0], int(counts.sum()), int(usual * radix)
    data = coded(tuples, sent, digit)
    back, back_counts = np.empty_like(tuples), np.empty_like(sent)
    assert decode_ordered_tuples(data, radix, total, digit, back, back_counts) == len(data) + UNWRITTEN
    assert np.array_equal(back, tuples)
    assert np.array_equal(back_counts, sent)


def test_the_largest_numbers_come_back() -> None:
    tuples = np.array([[0, 0], [2**22 - 1, 0], [0, 2**22 - 1], [2**22 - 1, 2**22 - 1]], np.int32)
    counts = np.array([1, 2**26, 1, 2**26], np.int64)
    data = coded(tuples, counts, 0)
    back, back_counts = np.empty_like(tuples), np.empty_like(counts)
    assert decode_ordered_tuples(data, 2**22, int(counts.sum()), 0, back, back_counts) == len(data) + UNWRITTEN
    assert np.array_equal(back, tuples)
    assert np.array_equal(back_counts, counts)


def test_what_does_not_fit_is_refused(rng: np.random.Generator) -> None:
    tuples, counts = table(rng, RADIX, 3, 100)
    total = int(counts.sum())
    data = coded(tuples, counts, 20)

    def result(data: np.ndarray, radix: int = RADIX, total: int = total) -> int:
        return int(decode_ordered_tuples(data, radix, total, 20, np.empty_like(tuples), np.empty_like(counts)))

    assert result(data, radix=int(tuples.max())) == OUT_OF_RANGE
    assert result(data, total=total - 1) == result(data, total=total + 1) == BAD_COUNTS
    assert result(np.full(400, 255, np.uint8)) == OUT_OF_RANGE
    assert result(data[:8]) in (OVERRUN, BAD_COUNTS, OUT_OF_RANGE)


def test_bits_after_the_last_number_are_refused() -> None:
    tuples, counts = np.zeros((1, 2), np.int32), np.ones(1, np.int64)
    data = coded(tuples, counts, 0)
    assert decode_ordered_tuples(data, 1, 1, 0, tuples, counts) == len(data) + UNWRITTEN
    data[-1] |= 1
    assert decode_ordered_tuples(data, 1, 1, 0, tuples, counts) == OUT_OF_RANGE


def test_too_little_room_is_said_not_overrun(rng: np.random.Generator) -> None:
    tuples, counts = table(rng, RADIX, 3, 2000)
    buffer = np.zeros(4096, np.uint8)
    assert encode_ordered_tuples(tuples, counts, 20, buffer[:2000]) == -1
    assert not buffer[2000:].any()


def test_any_bytes_decode_to_ascending_digits_in_range(rng: np.random.Generator) -> None:
    decoded = 0
    for _ in range(2000):
        data = rng.integers(0, 256, rng.integers(0, 40)).astype(np.uint8)
        tuples, counts = np.empty((3, 3), np.int32), np.empty(3, np.int64)
        if decode_ordered_tuples(data, 90, 40, 30, tuples, counts) >= 0:
            decoded += 1
            assert 0 <= tuples.min() <= tuples.max() < 90
            assert counts.sum() == 40
            codes = tuples @ 90 ** np.arange(3)
            assert (np.diff(codes) > 0).all()
    assert decoded > 0


@pytest.mark.parametrize(
    "setting", [{}, {"levels": 2, "group": 2, "keys": "random"}, {"scan": "coefficient", "qf": 50}]
)
def test_fast_codes_the_same_pixels_in_another_version(setting: dict[str, object]) -> None:
    for image in (textured(61, 77), textured(37, 50, 3), np.zeros((8, 8), np.uint8)):
        usual, fast = (Multilevel.create(effort=effort, **setting).encode(image) for effort in ("best", "fast"))
        assert (usual[4], fast[4]) == (1, RICE_VERSION)
        assert np.array_equal(Multilevel.create().decode(usual), Multilevel.create().decode(fast))
        assert describe(usual).payload == describe(fast).payload


@pytest.mark.thorough
def test_operations_are_counted_and_fewer() -> None:
    image = textured(61, 77)
    encoding, decoding = {}, {}
    for effort in ("best", "fast"):
        codec, traces = Multilevel.create(effort=effort), (CountingTrace(), CountingTrace())
        stream = codec.encode(image, trace=traces[0])
        assert np.array_equal(codec.decode(stream, trace=traces[1]), codec.decode(stream))
        encoding[effort], decoding[effort] = (trace.counts for trace in traces)
    assert encoding["fast"]["table_coding"].total < encoding["best"]["table_coding"].total / 2
    assert decoding["fast"]["table_decoding"].total < decoding["best"]["table_decoding"].total


def test_fast_has_no_codes_to_search() -> None:
    parts = unpack(Multilevel.create(decoding="search").encode(textured(20, 20)))
    forged = pack(replace(parts, header=replace(parts.header, rice=True)))
    with pytest.raises(BitstreamError, match="header: flags 1"):
        Multilevel.create().decode(forged)


@pytest.mark.parametrize(
    ("params", "reason"),
    [
        ({"effort": "normal"}, "static .* normal; .*fast"),
        ({"effort": "fast", "decoding": "search"}, "leave out"),
        ({"effort": "fast", "keys": (0.1234567891, 0.52345678987, 0.87987654321)}, "leave out"),
    ],
)
def test_efforts_of_the_profile_static(params: dict[str, object], reason: str) -> None:
    with pytest.raises(ValidationError, match=reason):
        MultilevelParams(**params)  # type: ignore[arg-type]
