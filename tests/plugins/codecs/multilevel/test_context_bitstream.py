"""The container of the profile: byte layout, strictness, and what is left where a slice is damaged."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from multilevel_pictures import textured

from codecbench import BitstreamError
from codecbench.plugins.codecs.multilevel import Multilevel, describe
from codecbench.plugins.codecs.multilevel.context.bitstream import unpack, unpack_intact


def stream_of(channels: int = 1, **params: object) -> bytes:
    return Multilevel.create(profile="context", qf=1.5, **params).encode(textured(45, 61, channels))


def repaired(body: bytes) -> bytes:
    return body + struct.pack("<I", zlib.crc32(body))


def changed(stream: bytes, offset: int, layout: str, value: float) -> bytes:
    body = bytearray(stream[:-4])
    struct.pack_into(f"<{layout}", body, offset, value)
    return repaired(bytes(body))


def refused(stream: bytes, reason: str) -> None:
    with pytest.raises(BitstreamError, match=reason):
        Multilevel.create().decode(stream)


def test_the_layout_is_as_documented() -> None:
    stream = stream_of(3, chroma=2, restart=1, color="ycbcr420")
    assert stream[:9] == b"CBML" + bytes([2, 1, 4 | 16, 3, 2])
    assert stream[9] == 32
    assert struct.unpack_from("<HIId", stream, 10) == (1, 61, 45, 1.5)
    sizes = struct.unpack_from("<3I", stream, 28 + 27)
    assert struct.unpack_from("<I", stream, 55 + 12)[0] == zlib.crc32(stream[: 55 + 12])
    position = 55 + 16
    for size in sizes:
        payload, checksum = stream[position : position + size], stream[position + size : position + size + 4]
        assert struct.unpack("<I", checksum)[0] == zlib.crc32(payload)
        position += size + 4
    assert len(stream) == position + 4
    assert struct.unpack("<I", stream[-4:])[0] == zlib.crc32(stream[:-4])


def test_sizes_are_described() -> None:
    stream = stream_of(3, restart=1)
    sizes = describe(stream)
    assert sizes.total == len(stream)
    assert sizes.payload == sum(map(len, unpack(stream)[1]))
    assert sizes.tables == sizes.keys == sizes.entries == ()


@pytest.mark.parametrize(
    ("offset", "layout", "value", "reason"),
    [
        (4, "B", 4, "version 4 is not"),
        (5, "B", 0, "profile 0"),
        (6, "B", 8 | 32, "flags"),
        (7, "B", 9, "color 9"),
        (7, "B", 1, "channel .*color rgb"),
        (8, "B", 3, "table 3"),
        (9, "B", 0, "chroma steps 0"),
        (10, "H", 1, "CRC-32.* header|truncated"),
        (12, "I", 0, "width 0"),
        (12, "I", 2**31, "samples allowed"),
        (16, "I", 2**19, "cannot come from"),
        (16, "I", 53, "truncated|trailing|range"),
        (20, "d", float("nan"), "qf nan"),
        (20, "d", 0.0, "qf 0.0"),
        (28, "b", 63, "biases"),
        (28, "b", -39, "biases"),
    ],
)
def test_header_faults(offset: int, layout: str, value: float, reason: str) -> None:
    refused(changed(stream_of(), offset, layout, value), reason)


def test_payload_faults() -> None:
    stream = stream_of()
    refused(repaired(stream[:-4] + b"\0"), "trailing")
    refused(repaired(stream[:-5]), "truncated|trailing|range")
    refused(stream[:-1], "CRC-32")
    refused(stream[:20], "truncated")
    refused(repaired(stream[:30]), "truncated")


@pytest.mark.parametrize("place", [40, 60, -30, -6])
def test_any_flipped_bit_is_refused(place: int) -> None:
    stream = bytearray(stream_of(3, restart=1))
    stream[place] ^= 16
    refused(bytes(stream), "CRC-32")


def test_a_custom_table_travels() -> None:
    stream = stream_of(table=tuple(range(8, 72)))
    assert stream[8] == 255
    assert np.array_equal(unpack(stream)[0].table.reshape(64), np.arange(8, 72))


def test_only_the_damaged_slice_is_missing() -> None:
    stream = bytearray(stream_of(3, restart=1))
    sizes = struct.unpack_from("<3I", stream, 55)
    stream[71 + sizes[0] + 4 + sizes[1] // 2] ^= 1
    payloads = unpack_intact(bytes(stream))[1]
    assert [payload is None for payload in payloads] == [False, True, False]
    cut = bytes(stream[: 71 + sizes[0] + 4])
    assert [payload is None for payload in unpack_intact(cut)[1]] == [False, True, True]


def test_nothing_can_be_salvaged_without_a_header_or_restart_points() -> None:
    with pytest.raises(BitstreamError, match="restart"):
        unpack_intact(stream_of())
    stream = bytearray(stream_of(3, restart=1))
    stream[56] ^= 1
    with pytest.raises(BitstreamError, match=r"CRC-32.* header"):
        unpack_intact(bytes(stream))
