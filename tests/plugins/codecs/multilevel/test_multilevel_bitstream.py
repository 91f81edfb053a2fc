"""The strict decoder: every fault has its reason, and no bytes crash it, hang it or change a picture in silence."""

from __future__ import annotations

import struct
import time
import tracemalloc
import zlib
from dataclasses import replace

import numpy as np
import pytest
from multilevel_pictures import textured

from codecbench.core.contracts.errors import BitstreamError, CodecbenchError, ParamsError
from codecbench.plugins.codecs.multilevel import Multilevel, describe
from codecbench.plugins.codecs.multilevel.bitstream import Bitstream, pack, unpack

DECODER = Multilevel.create()
SETTINGS = (
    {},
    {"decoding": "search"},
    {"effort": "fast"},
    {"levels": 2, "scan": "coefficient"},
    {"levels": 2, "decoding": "search", "keys": "random"},
    {"levels": 3, "group": 2, "color": "ycbcr420", "table": tuple(range(1, 65))},
    {"qf": 40.0, "decoding": "search", "keys": (0.1234567891, 0.52345678987, 0.87987654321)},
)


def sealed(body: bytes | bytearray) -> bytes:
    """The body with a valid checksum: what an adversary would send."""
    return bytes(body) + struct.pack("<I", zlib.crc32(body))


def changed(bitstream: bytes, offset: int, layout: str, value: float) -> bytes:
    """The bitstream with one field replaced and the checksum made right."""
    body = bytearray(bitstream[:-4])
    struct.pack_into("<" + layout, body, offset, value)
    return sealed(body)


def refused(bitstream: bytes, reason: str) -> None:
    with pytest.raises(BitstreamError, match=reason):
        DECODER.decode(bitstream)


@pytest.fixture(scope="module")
def stream() -> bytes:
    return Multilevel.create(qf=5).encode(textured(61, 77))


@pytest.fixture(scope="module")
def searched() -> bytes:
    return Multilevel.create(qf=5, decoding="search").encode(textured(61, 77))


def test_foreign_and_short_bytes(stream: bytes) -> None:
    refused(b"", "starts with nothing")
    refused(b"\x89PNG\r\n\x1a\n" + bytes(60), "not a multi-level bitstream: starts with 89504e47")
    for size in range(1, 40):
        refused(stream[:size], "truncated|damaged")


def test_every_truncation_and_extension(stream: bytes) -> None:
    for size in range(len(stream)):
        with pytest.raises(BitstreamError):
            DECODER.decode(stream[:size])
    refused(stream + b"\0", "damaged")
    refused(sealed(stream[:-4] + b"\0"), "1 trailing bytes after the payload")


def test_bad_checksum(stream: bytes) -> None:
    body = bytearray(stream)
    body[-1] ^= 1
    refused(bytes(body), "damaged: CRC-32")


@pytest.mark.parametrize(
    ("offset", "layout", "value", "reason"),
    [
        (4, "B", 4, "^version 4 .* [123], [123] and [123]$"),
        (5, "B", 1, "profile 1"),
        (6, "B", 8, "flags 8"),
        (7, "B", 4, "color 4"),
        (7, "B", 1, "channel .*color rgb"),
        (8, "B", 3, "table 3"),
        (9, "B", 0, "levels 0"),
        (9, "B", 17, "levels 17"),
        (10, "B", 1, "group 1"),
        (10, "B", 17, "group 17"),
        (11, "B", 1, "reserved byte 1"),
        (12, "I", 0, "width 0"),
        (16, "I", 0, "height 0"),
        (12, "I", 2**32 - 1, "samples allowed"),
        (16, "I", 2**31, "samples allowed"),
        (16, "I", 100_000, "x100000 pixels .*payload"),
        (16, "I", 69, "counts do not"),
        (20, "d", 0.0, "qf 0.0"),
        (20, "d", -5.0, "qf -5.0"),
        (20, "d", float("nan"), "qf nan"),
        (20, "d", float("inf"), "qf inf"),
        (28, "i", 1, "offset 1"),
        (28, "i", -(2**31), "offset"),
        (32, "I", 0, "number of digits 0"),
        (32, "I", 2**32 - 1, "number of digits"),
        (32, "I", 300, "out of range"),
        (36, "I", 0, "level 1: 0 table"),
        (36, "I", 10**6, "1000000 table .*1707 groups"),
        (40, "I", 2**32 - 1, "truncated: table .*level 1 "),
        (40, "I", 3, "truncated|trailing|range|counts|payload"),
    ],
)
def test_header_faults(stream: bytes, offset: int, layout: str, value: float, reason: str) -> None:
    refused(changed(stream, offset, layout, value), reason)


def with_level(stream: bytes, **changes: object) -> bytes:
    parts = unpack(stream)
    return pack(Bitstream(parts.header, [replace(parts.levels[0], **changes)], parts.payload))  # type: ignore[arg-type]


def test_section_faults(stream: bytes) -> None:
    parts = unpack(stream)
    (level,) = parts.levels
    refused(with_level(stream, table=level.table + b"\1"), "level 1: trailing")
    refused(with_level(stream, table=level.table + b"\0"), "level 1: trailing")
    refused(with_level(stream, table=level.table[:-1]), "level 1: truncated")
    refused(with_level(stream, table=level.table[:-9]), "table of level 1")
    refused(with_level(stream, entries=level.entries - 1), "counts do not")
    refused(with_level(stream, entries=level.entries + 1), "table of level 1")
    refused(pack(Bitstream(parts.header, parts.levels, parts.payload + b"\0")), "payload: trailing bytes")
    refused(pack(Bitstream(parts.header, parts.levels, parts.payload[:-1])), "payload: truncated|histogram")
    refused(pack(Bitstream(parts.header, parts.levels, parts.payload[:-9])), "payload")
    refused(pack(Bitstream(parts.header, parts.levels, b"")), "payload")
    refused(pack(Bitstream(parts.header, parts.levels, parts.payload[::-1])), "histogram")


@pytest.mark.parametrize(
    ("keys", "reason"),
    [
        ([0, 1, 2], "key 0 is not"),
        ([1, -5, 2], "key -5 is not"),
        ([1, 2, 3], "one-to-one"),
        ([1, 2, 2**61], "codes exceed 62"),
        ([1, 2, 2**40], "not super-increasing"),
        ([1, 1000, 1000_000], "to no tuple"),
    ],
)
def test_key_faults(searched: bytes, keys: list[int], reason: str) -> None:
    refused(with_level(searched, keys=np.array(keys, np.int64)), reason)


def test_codes_beyond_the_largest(searched: bytes) -> None:
    (level,) = unpack(searched).levels
    refused(changed(searched, 32, "I", unpack(searched).header.radix - 20), "range|no tuple")
    assert level.keys[0] == 1


def test_sequential_search_refuses_what_would_take_hours(searched: bytes) -> None:
    slow = Multilevel.create(search="sequential")
    with pytest.raises(ParamsError, match="takes too long"):
        slow.decode(Multilevel.create(qf=1, decoding="search").encode(textured(256, 256)))


@pytest.mark.parametrize(("width", "height"), [(8192, 8192), (2**26, 1), (1, 2**26), (4096, 4096), (1024, 1024)])
@pytest.mark.parametrize("levels", [1, 16])
def test_small_streams_of_large_pictures_cost_little(width: int, height: int, levels: int) -> None:
    small = Multilevel.create(levels=levels).encode(np.zeros((8, 8), np.uint8))
    parts = unpack(small)
    bomb = pack(replace(parts, header=replace(parts.header, width=width, height=height)))
    tracemalloc.start()
    if width * height > 1 << 20:
        with pytest.raises(BitstreamError):
            DECODER.decode(bomb)
    else:  # so many may come from nothing: sixteen tables of one entry are a flat picture
        assert levels == 1 or DECODER.decode(bomb).shape == (height, width)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 64 << 20


@pytest.mark.thorough
@pytest.mark.parametrize("setting", [{}, {"decoding": "search"}])
def test_small_streams_of_large_tables_cost_little(setting: dict[str, str]) -> None:
    """A table of 300,000 entries in a few bytes."""
    parts = unpack(Multilevel.create(**setting).encode(textured(1024, 1024)))  # type: ignore[arg-type]
    (level,) = parts.levels
    start = time.process_time()
    for fill in (b"", bytes(60), b"\xff" * 60, bytes(range(60))):
        greedy = replace(level, entries=300_000, table=fill)
        with pytest.raises(BitstreamError):
            DECODER.decode(pack(replace(parts, levels=[greedy])))
    assert time.process_time() - start < 4


def test_empty_pictures_of_many_pixels_come_back() -> None:
    """Their payload is filled up so that its size accounts for the pixels."""
    image = np.zeros((1500, 1600), np.uint8)
    stream = Multilevel.create(scan="coefficient").encode(image)
    assert len(stream) < 3000
    assert np.array_equal(DECODER.decode(stream), image)
    parts = unpack(stream)
    refused(pack(replace(parts, payload=parts.payload + b"\0")), "trailing")
    refused(pack(replace(parts, payload=parts.payload[:-1])), "cannot come from")
    refused(pack(replace(parts, payload=parts.payload[:-1] + b"\1")), "trailing")


@pytest.mark.parametrize("setting", SETTINGS)
def test_sizes_add_up(setting: dict[str, object]) -> None:
    stream = Multilevel.create(**setting).encode(textured(40, 56, 3))  # type: ignore[arg-type]
    sizes = describe(stream)
    levels = setting.get("levels", 1)
    assert sizes.total == len(stream)
    assert len(sizes.tables) == len(sizes.keys) == len(sizes.entries) == levels
    group = setting.get("group", 3)
    assert sizes.keys == (8 * group if setting.get("decoding") == "search" else 0,) * levels  # type: ignore[operator]
    assert sizes.header == 36 + (128 if "table" in setting else 0) + 8 * levels + 8  # type: ignore[operator]
    with pytest.raises(CodecbenchError):
        describe(stream[:-1])
