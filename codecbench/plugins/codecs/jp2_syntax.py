"""Boxes and marker segments of a JP2 file, as far as our own files use them (ITU-T T.800 annexes A and I)."""

from __future__ import annotations

import struct
import zlib
from itertools import accumulate

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import LAYOUTS, MAX_PIXELS

MAX_JP2_PIXELS = MAX_PIXELS // 4
"""OpenJPEG holds an image twice, in planes of 32-bit numbers."""

_BOXES = (b"jP  ", b"ftyp", b"jp2h", b"jp2c")
_SIGNATURE = b"\r\n\x87\n"
_FILE_TYPE = b"jp2 \0\0\0\0jp2 "
_COLOR_SPACES = {1: b"\1\0\0\0\0\0\x11", 3: b"\1\0\0\0\0\0\x10"}
"""Enumerated color spaces (T.800 I.5.3.3): 17 grayscale, 16 sRGB."""
SOC, SIZ, COD, PLT, QCD, COM, SOT, SOD, EOC = 0xFF4F, 0xFF51, 0xFF52, 0xFF58, 0xFF5C, 0xFF64, 0xFF90, 0xFF93, 0xFFD9
_SIZ = struct.Struct(">HIIIIIIIIH")
_COD = struct.Struct(">BBHBBBBBB")
_IHDR = struct.Struct(">IIHBBBB")
_SOT = struct.Struct(">HIBB")
_TILE_PART_LENGTH = 6
"""Offset of the tile-part length from SOT's marker."""
_WAVELET_COMPRESSION = 7
_BLOCKS = ((4, 4, 0), (3, 3, 0), (2, 2, 0))  # 64x64, 32x32 and 16x16 code blocks, no special coding
_MAX_DECOMPOSITIONS = 5
MAX_LAYERS = 16
"""Each layer costs a packet header even if its packet is empty."""
_OPENJPEG_COMMENT = b"Created by OpenJPEG version"
_CRC_COMMENT = b"codecbench CRC-32: "
_CRC_DIGITS = 8
_MAIN_HEADER_BYTES = 400
"""Upper bound of our headers: boxes, SIZ, COD, QCD and the comment."""


def insert_checksum(bitstream: bytes) -> bytes:
    """Replace OpenJPEG's name and version in the comment by a CRC-32 of all other bytes, in hexadecimal."""
    place = bitstream.find(_OPENJPEG_COMMENT, 4, _MAIN_HEADER_BYTES)
    text_bytes = int.from_bytes(bitstream[place - 4 : place - 2], "big") - 4 if place > 0 else 0
    if text_bytes < len(_CRC_COMMENT) + _CRC_DIGITS:
        raise RuntimeError("this OpenJPEG does not write the comment in which codecbench puts a checksum")
    before = bitstream[:place] + _CRC_COMMENT
    after = b" " * (text_bytes - len(_CRC_COMMENT) - _CRC_DIGITS) + bitstream[place + text_bytes :]
    crc = zlib.crc32(after, zlib.crc32(before))
    return before + f"{crc:08x}".encode() + after


def _check_crc(bitstream: bytes) -> None:
    place = bitstream.find(_CRC_COMMENT, 0, _MAIN_HEADER_BYTES)
    if place < 0:
        raise BitstreamError("jpeg2000: no checksum; codecbench did not write this file")
    view, digits = memoryview(bitstream), place + len(_CRC_COMMENT)
    crc = zlib.crc32(view[digits + _CRC_DIGITS :], zlib.crc32(view[:digits]))
    if bitstream[digits : digits + _CRC_DIGITS] != f"{crc:08x}".encode():
        raise BitstreamError("jpeg2000: checksum mismatch, the file is damaged")


def read_shape(bitstream: bytes) -> tuple[tuple[int, ...], int]:
    """Check the structure of a JP2 file from end to end; return the shape that it promises and the bits of its samples.

    Accepts what our encoder writes: four boxes, one tile in one part, up to MAX_LAYERS consecutive layers, 8-bit
    components or a 16-bit one without subsampling, default precincts, square code blocks, and a right checksum. Raises
    BitstreamError for anything else.
    """
    _check_crc(bitstream)
    return _read_structure(bitstream)


def file_from_prefix(prefix: bytes) -> tuple[bytes, tuple[tuple[int, ...], int]]:
    """Make a decodable file of the first bytes of one of ours: fix its lengths, append EOC; returns shape and bits too.

    With layers the file ends after the last complete packet: if a packet is cut inside a code block, OpenJPEG drops
    what earlier layers contributed to the block. The checksum stays that of the whole file. Raises BitstreamError if
    the bytes end within the headers or are not of our file.
    """
    box = 0
    for _ in _BOXES[:-1]:
        length = int.from_bytes(prefix[box : box + 4], "big")
        if not 8 <= length <= len(prefix) - box:
            raise BitstreamError(f"jpeg2000: ends inside the headers, in the box at byte {box}")
        box += length
    position, code, layers = box + 8 + 2, 0, 1
    while code != SOT:
        code, content = _read_marker_segment(prefix, position)
        position += 4 + len(content)
        if code == COD and len(content) == _COD.size:
            _, _, layers, *_ = _COD.unpack(content)
    tile_part = position - 4 - len(content)
    data, lengths = _read_packet_lengths(prefix, position)
    ends = [data + end for end in accumulate(lengths) if data + end <= len(prefix)]
    if layers > 1 and len(ends) * layers >= len(lengths) > 0:  # the first layer, which has none before, is there
        prefix = prefix[: ends[-1]]
    file = bytearray(prefix + EOC.to_bytes(2, "big"))
    struct.pack_into(">I", file, box, len(file) - box)
    struct.pack_into(">I", file, tile_part + _TILE_PART_LENGTH, len(prefix) - tile_part)
    return bytes(file), _read_structure(bytes(file))


def _read_packet_lengths(bitstream: bytes, position: int) -> tuple[int, list[int]]:
    """Return the start of the packets behind the tile-part header, and their lengths if there is a PLT."""
    lengths, length = [], 0
    while bitstream[position : position + 2] != SOD.to_bytes(2, "big"):
        if bitstream[position : position + 2] != PLT.to_bytes(2, "big"):
            raise BitstreamError("jpeg2000: no SOD after the tile-part header")
        _, content = _read_marker_segment(bitstream, position)
        for byte in content[1:]:  # the first numbers the segments; T.800 A.7.3
            length = length << 7 | byte & 0x7F
            if length > len(bitstream) << 16:
                raise BitstreamError(f"jpeg2000: PLT claims a packet of {length} bytes")
            if byte < 0x80:
                lengths.append(length)
                length = 0
        position += 4 + len(content)
    return position + 2, lengths


def _read_structure(bitstream: bytes) -> tuple[tuple[int, ...], int]:
    boxes = _read_boxes(bitstream, 0, len(bitstream))
    if tuple(kind for kind, _, _ in boxes) != _BOXES or bitstream[8:12] != _SIGNATURE:
        raise BitstreamError(f"jpeg2000: not a JP2 file of codecbench: boxes {[kind for kind, _, _ in boxes]}")
    if bitstream[boxes[1][1] : boxes[1][2]] != _FILE_TYPE:
        raise BitstreamError(f"jpeg2000: file type {bitstream[boxes[1][1] : boxes[1][2]]!r} is not that of a JP2 file")
    inner = _read_boxes(bitstream, boxes[2][1], boxes[2][2])
    if [kind for kind, _, _ in inner] != [b"ihdr", b"colr"] or inner[0][2] - inner[0][1] != _IHDR.size:
        raise BitstreamError("jpeg2000: the JP2 header must contain one image header and one color box")
    height, width, channels, depth, compression, *_ = _IHDR.unpack_from(bitstream, inner[0][1])
    if (channels, depth + 1) not in LAYOUTS or compression != _WAVELET_COMPRESSION:
        got = f"{channels} components, depth field {depth}"
        raise BitstreamError(f"jpeg2000: {got}; 1 or 3 of 8 bits and 1 of 16 are read")
    if not 0 < height * width <= MAX_JP2_PIXELS:
        raise BitstreamError(f"jpeg2000: {width}x{height} is not within 1..{MAX_JP2_PIXELS} pixels")
    if bitstream[inner[1][1] : inner[1][2]] != _COLOR_SPACES[channels]:
        raise BitstreamError(f"jpeg2000: the color box does not fit {channels} component(s)")
    _check_codestream(bitstream, boxes[3][1], (width, height, channels, depth))
    return ((height, width) if channels == 1 else (height, width, channels)), depth + 1


def _read_boxes(bitstream: bytes, start: int, end: int) -> list[tuple[bytes, int, int]]:
    """Type, content start and content end of the boxes that fill `start` to `end`."""
    boxes = []
    while start < end:
        if end - start < 8:
            raise BitstreamError(f"jpeg2000: {end - start} stray bytes at {start}; the file is cut or damaged")
        length, kind = struct.unpack_from(">I4s", bitstream, start)
        if not 8 <= length <= end - start:
            raise BitstreamError(f"jpeg2000: box {kind!r} at byte {start} claims {length} bytes of {end - start}")
        boxes.append((kind, start + 8, start + length))
        start += length
    return boxes


def _check_codestream(bitstream: bytes, start: int, size: tuple[int, int, int, int]) -> None:
    """Check the headers and the end of the codestream at `start`. size: width, height, channels and depth field."""
    if bitstream[start : start + 2] != SOC.to_bytes(2, "big"):
        raise BitstreamError("jpeg2000: the codestream does not start with SOC")
    position, seen = start + 2, []
    while True:
        code, content = _read_marker_segment(bitstream, position)
        seen.append(code)
        if code == SIZ:
            _check_size(content, *size)
        elif code == COD:
            _check_coding_style(content, size[2])
        elif code == SOT:
            break
        elif code not in (QCD, COM):
            raise BitstreamError(f"jpeg2000: marker {code:04X} at byte {position} is not one that codecbench writes")
        position += 4 + len(content)
    if seen[0] != SIZ or any(seen.count(code) != 1 for code in (SIZ, COD, QCD)):
        raise BitstreamError("jpeg2000: the main header needs SIZ first, and COD and QCD once")
    if len(content) != _SOT.size:
        raise BitstreamError(f"jpeg2000: SOT has {len(content)} bytes")
    tile, length, part, parts = _SOT.unpack(content)
    ends = position + length == len(bitstream) - 2 and bitstream[-2:] == EOC.to_bytes(2, "big")
    if not ends or (tile, part, parts) != (0, 0, 1):
        raise BitstreamError(f"jpeg2000: tile {tile}, part {part} of {parts}, does not end with the file")
    _read_packet_lengths(bitstream, position + 4 + len(content))


def _read_marker_segment(bitstream: bytes, position: int) -> tuple[int, bytes]:
    if position + 4 > len(bitstream):
        raise BitstreamError(f"jpeg2000: ends inside the header at byte {position}")
    code, length = struct.unpack_from(">HH", bitstream, position)
    if length < 2 or position + 2 + length > len(bitstream):
        raise BitstreamError(f"jpeg2000: marker {code:04X} at byte {position} claims {length} bytes")
    return code, bitstream[position + 4 : position + 2 + length]


def _check_size(content: bytes, width: int, height: int, channels: int, depth: int) -> None:
    if len(content) != _SIZ.size + 3 * channels:
        raise BitstreamError(f"jpeg2000: SIZ has {len(content)} bytes for {channels} components")
    _, *numbers = _SIZ.unpack_from(content)
    components = content[_SIZ.size :]
    if numbers != [width, height, 0, 0, width, height, 0, 0, channels] or components != bytes((depth, 1, 1)) * channels:
        raise BitstreamError(f"jpeg2000: SIZ {numbers} is not one tile of {width}x{height}x{channels}")


def _check_coding_style(content: bytes, channels: int) -> None:
    if len(content) != _COD.size:
        raise BitstreamError(f"jpeg2000: COD has {len(content)} bytes, not {_COD.size}")
    style, progression, layers, color_transform, levels, *blocks, wavelet = _COD.unpack(content)
    is_style = (style, progression) == (0, 0) and 1 <= layers <= MAX_LAYERS
    if not is_style or tuple(blocks) not in _BLOCKS or color_transform != (channels == 3):
        raise BitstreamError(f"jpeg2000: coding style {tuple(content)} is not one that codecbench writes")
    if levels > _MAX_DECOMPOSITIONS or wavelet > 1:
        raise BitstreamError(
            f"jpeg2000: {levels} decompositions of wavelet {wavelet}; at most {_MAX_DECOMPOSITIONS} of 0 or 1 are read"
        )
