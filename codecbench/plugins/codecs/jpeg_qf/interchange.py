"""Write and read the JFIF file around a sequential Huffman-coded scan (ITU-T T.81 annex B, JFIF 1.02).

Our files are ordinary JFIF files with one addition that other decoders skip: an APP15 segment, `CRC` and a zero byte,
then a big-endian CRC-32 of all other bytes of the file. It follows a JFIF header whose densities (equal, so that pixels
are square) are not those of other encoders. A file that agrees with most of these first bytes is one of ours and must
have the checksum, so that damage to the mark alone cannot disable the check. Other files are read without it.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import MAX_PIXELS
from codecbench.plugins.codecs.jfif import (
    APP0,
    APP14,
    APP15,
    DHT,
    DQT,
    DRI,
    SOF_BASELINE,
    SOF_EXTENDED,
    SOS,
    Component,
    FrameHeader,
    check_plausible,
    read_frame_header,
    read_segments,
)
from codecbench.plugins.codecs.jpeg_qf.huffman_tables import HuffmanTable

MAX_JPEG_QF_PIXELS = MAX_PIXELS // 4
"""Limit of the memory for all coefficients of an image as 32-bit numbers."""
_DENSITY = 0x4342
_CRC_BYTES = 4
_PREFIX = (
    b"\xff\xd8"
    + struct.pack(">BBH5sBBBHHBB", 0xFF, APP0, 16, b"JFIF\0", 1, 2, 0, _DENSITY, _DENSITY, 0, 0)
    + struct.pack(">BBH4s", 0xFF, APP15, 2 + 4 + _CRC_BYTES, b"CRC\0")
)
_OURS = len(_PREFIX) - 6
"""Number of equal prefix bytes from which a file is ours; libjpeg's files agree in 17."""
_SEQUENTIAL = bytes((0, 63, 0))  # spectral selection 0..63, no successive approximation


@dataclass(frozen=True)
class CodedPicture:
    """Content of a file: frame header, tables and the entropy-coded segment."""

    header: FrameHeader
    quantizers: dict[int, NDArray[np.uint16]]
    """Steps (64,) in zigzag order, by destination."""
    huffman_tables: dict[tuple[int, int], HuffmanTable]
    """Tables by class (0 DC, 1 AC) and destination."""
    selectors: tuple[tuple[int, int], ...]
    """DC and AC destination of each component."""
    restart_interval: int
    """In MCUs, 0 for none."""
    scan_data: bytes


def write_file(picture: CodedPicture) -> bytes:
    """Write a JFIF file, baseline if its steps fit 8 bits.

    Steps over 255 are written with 16 bits in an extended sequential frame, as libjpeg does and reads them,
    although T.81 B.2.4.1 reserves 16 bits for 12-bit samples.
    """
    header = picture.header
    wide = any(steps.max() > 255 for steps in picture.quantizers.values())
    frame = struct.pack(">BHHB", 8, header.height, header.width, len(header.components))
    scan = bytes([len(header.components)])
    for component, (dc, ac) in zip(header.components, picture.selectors, strict=True):
        frame += bytes((component.id, component.h << 4 | component.v, component.table))
        scan += bytes((component.id, dc << 4 | ac))
    quantizers = b"".join(
        bytes([wide << 4 | destination]) + steps.astype(">u2" if wide else "u1").tobytes()
        for destination, steps in picture.quantizers.items()
    )
    huffman = b"".join(
        bytes([kind << 4 | destination]) + table.lengths + table.symbols
        for (kind, destination), table in picture.huffman_tables.items()
    )
    after = _segment(DQT, quantizers) + _segment(SOF_EXTENDED if wide else SOF_BASELINE, frame)
    after += _segment(DHT, huffman) + _segment(SOS, scan + _SEQUENTIAL) + picture.scan_data + b"\xff\xd9"
    return _PREFIX + zlib.crc32(after, zlib.crc32(_PREFIX)).to_bytes(_CRC_BYTES, "big") + after


def _segment(code: int, content: bytes) -> bytes:
    return struct.pack(">BBH", 0xFF, code, 2 + len(content)) + content


def read_file(bitstream: bytes) -> CodedPicture:
    """Read a sequential Huffman-coded JPEG file of one scan; the checksum is verified if the file is ours.

    Raises BitstreamError for other kinds of JPEG (progressive, arithmetic, lossless, several scans, 12 bits,
    RGB components) and for anything inconsistent.
    """
    _check_crc(bitstream)
    segments = read_segments(bitstream, "jpeg_qf")
    header = read_frame_header(segments, "jpeg_qf")
    if header.code not in (SOF_BASELINE, SOF_EXTENDED):
        raise BitstreamError(f"jpeg_qf: frame type FF{header.code:02X}; only sequential Huffman-coded frames are read")
    if header.width * header.height > MAX_JPEG_QF_PIXELS:
        raise BitstreamError(f"jpeg_qf: {header.width}x{header.height} is more than {MAX_JPEG_QF_PIXELS} pixels")
    codes = [segment.code for segment in segments]
    if codes.count(SOS) != 1 or codes[-1] != SOS:
        raise BitstreamError(f"jpeg_qf: {codes.count(SOS)} scans; files of one scan at the end are read")
    check_plausible(header, segments, "jpeg_qf")
    quantizers: dict[int, NDArray[np.uint16]] = {}
    huffman_tables: dict[tuple[int, int], HuffmanTable] = {}
    restart_interval = 0
    for segment in segments:
        if segment.code == DQT:
            quantizers |= _read_quantizers(segment.content)
        elif segment.code == DHT:
            huffman_tables |= _read_huffman_tables(segment.content)
        elif segment.code == DRI:
            restart_interval = _read_restart_interval(segment.content)
        elif segment.code == APP14:
            _check_adobe(segment.content)
    selectors = _read_scan_header(segments[-1].content, header.components)
    picture = CodedPicture(header, quantizers, huffman_tables, selectors, restart_interval, segments[-1].scan_data)
    _check_tables_and_sampling(picture)
    return picture


def _check_crc(bitstream: bytes) -> None:
    """Verify the checksum if the file is ours."""
    if sum(ours == got for ours, got in zip(_PREFIX, bitstream, strict=False)) < _OURS:
        return
    content = len(_PREFIX) + _CRC_BYTES
    crc = zlib.crc32(memoryview(bitstream)[content:], zlib.crc32(_PREFIX))
    if bitstream[:content] != _PREFIX + crc.to_bytes(_CRC_BYTES, "big"):
        raise BitstreamError("jpeg_qf: checksum mismatch, the file is damaged")


def _read_quantizers(content: bytes) -> dict[int, NDArray[np.uint16]]:
    quantizers, position = {}, 0
    while position < len(content):
        precision, destination = content[position] >> 4, content[position] & 15
        steps = content[position + 1 : position + 1 + 64 * (1 + precision)]
        if precision > 1 or destination > 3 or len(steps) != 64 * (1 + precision):
            raise BitstreamError(f"jpeg_qf: a quantization table for {destination} of precision {precision} is broken")
        quantizers[destination] = np.frombuffer(steps, ">u2" if precision else np.uint8).astype(np.uint16)
        if quantizers[destination].min() == 0:
            raise BitstreamError("jpeg_qf: a quantization step is zero")
        position += 1 + len(steps)
    return quantizers


def _read_huffman_tables(content: bytes) -> dict[tuple[int, int], HuffmanTable]:
    tables, position = {}, 0
    while position < len(content):
        kind, destination = content[position] >> 4, content[position] & 15
        lengths = content[position + 1 : position + 17]
        symbols = content[position + 17 : position + 17 + sum(lengths)]
        if kind > 1 or destination > 3:
            raise BitstreamError(f"jpeg_qf: a Huffman table of class {kind} for {destination} is invalid")
        tables[kind, destination] = HuffmanTable(lengths, symbols)
        position += 17 + len(symbols)
    return tables


def _read_restart_interval(content: bytes) -> int:
    if len(content) != 2:
        raise BitstreamError(f"jpeg_qf: DRI has {len(content)} bytes, not 2")
    return int.from_bytes(content, "big")


def _check_adobe(content: bytes) -> None:
    if content.startswith(b"Adobe") and len(content) == 12 and content[11] != 1:
        raise BitstreamError(f"jpeg_qf: Adobe color transform {content[11]}; only gray and YCbCr are read")


def _read_scan_header(content: bytes, components: tuple[Component, ...]) -> tuple[tuple[int, int], ...]:
    """DC and AC destinations of each component of the frame; the scan must have all components in order."""
    count = len(components)
    if len(content) != 1 + 2 * count + len(_SEQUENTIAL) or content[0] != count:
        raise BitstreamError(f"jpeg_qf: the scan does not contain the {count} component(s) of the frame")
    if content[-3:] != _SEQUENTIAL or list(content[1:-3:2]) != [component.id for component in components]:
        raise BitstreamError("jpeg_qf: the scan header does not fit a sequential frame")
    selectors = tuple((byte >> 4, byte & 15) for byte in content[2:-3:2])
    if any(max(pair) > 3 for pair in selectors):
        raise BitstreamError(f"jpeg_qf: Huffman table destinations {selectors} are not within 0..3")
    return selectors


def _check_tables_and_sampling(picture: CodedPicture) -> None:
    components = picture.header.components
    for component, (dc, ac) in zip(components, picture.selectors, strict=True):
        if component.table not in picture.quantizers:
            raise BitstreamError(f"jpeg_qf: quantization table {component.table} is not defined")
        if (0, dc) not in picture.huffman_tables or (1, ac) not in picture.huffman_tables:
            raise BitstreamError(f"jpeg_qf: Huffman table DC {dc} or AC {ac} is not defined")
    sampling = tuple((component.h, component.v) for component in components)
    if len(components) == 3 and (sampling[0] not in ((1, 1), (2, 1), (2, 2)) or sampling[1:] != ((1, 1), (1, 1))):
        raise BitstreamError(f"jpeg_qf: sampling factors {sampling}; 4:4:4, 4:2:2 and 4:2:0 are read")
    if len(components) == 3 and [component.id for component in components] == list(b"RGB"):
        raise BitstreamError("jpeg_qf: RGB components; only gray and YCbCr are read")
