"""Marker segments and frame header of a JPEG file (ITU-T T.81 annex B), and its quality by its quantization table."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import MAX_PIXELS
from codecbench.plugins.codecs.dct.tables import LUMINANCE, ZIGZAG

SOI, EOI, SOS, DQT, DHT, DRI, COM, DAC = 0xD8, 0xD9, 0xDA, 0xDB, 0xC4, 0xDD, 0xFE, 0xCC
SOF_BASELINE, SOF_EXTENDED, SOF_PROGRESSIVE = 0xC0, 0xC1, 0xC2
FRAME_HEADERS = frozenset({0xC0, 0xC1, 0xC2, 0xC3, 0xC5, 0xC6, 0xC7, 0xC9, 0xCA, 0xCB, 0xCD, 0xCE, 0xCF})
"""SOF0..SOF15, with the lossless, hierarchical and arithmetic ones, which no codec here reads."""
APP0, APP14, APP15 = 0xE0, 0xEE, 0xEF
MAX_SIDE = 65535

_ALLOWED = FRAME_HEADERS | {SOS, DQT, DHT, DRI, COM, DAC} | set(range(APP0, APP15 + 1))
_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7]", re.DOTALL)


@dataclass(frozen=True)
class Segment:
    """One marker segment."""

    code: int
    """Second byte of the marker."""
    offset: int
    """Where the content starts in the file."""
    content: bytes
    """The bytes after the length."""
    scan_data: bytes = b""
    """Entropy-coded data after SOS."""


@dataclass(frozen=True)
class Component:
    """A component of a frame."""

    id: int
    h: int
    """Horizontal sampling factor."""
    v: int
    """Vertical sampling factor."""
    table: int
    """Destination of its quantization table."""


@dataclass(frozen=True)
class FrameHeader:
    """Content of SOFn; the size is in pixels."""

    code: int
    """Second byte of the marker."""
    width: int
    height: int
    components: tuple[Component, ...]

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the decoded image: one component is gray, three are RGB."""
        return (self.height, self.width) if len(self.components) == 1 else (self.height, self.width, 3)

    @property
    def blocks(self) -> int:
        """Number of 8x8 blocks of all components, before padding to whole MCUs."""
        h_max = max(component.h for component in self.components)
        v_max = max(component.v for component in self.components)
        return sum(
            -(-self.width * component.h // (8 * h_max)) * -(-self.height * component.v // (8 * v_max))
            for component in self.components
        )


def read_segments(bitstream: bytes, name: str) -> list[Segment]:
    """Read all marker segments between SOI and EOI, in order.

    Raises BitstreamError, led by the codec's `name`, if the marker syntax is broken: no SOI, no EOI as the
    very last bytes, a length beyond the end, a reserved or misplaced marker, or bytes that belong to none.
    """
    if bitstream[:2] != b"\xff\xd8":
        raise BitstreamError(f"{name}: not a JPEG file, it starts with {bitstream[:2]!r}")
    segments: list[Segment] = []
    position = 2
    while True:
        if position + 2 > len(bitstream) or bitstream[position] != 0xFF:
            raise BitstreamError(
                f"{name}: no marker at byte {position} of {len(bitstream)}; the file is cut or damaged"
            )
        code = bitstream[position + 1]
        if code == EOI:
            break
        segment, position = _read_segment(bitstream, position, code, name)
        segments.append(segment)
    if position + 2 != len(bitstream):
        raise BitstreamError(f"{name}: {len(bitstream) - position - 2} bytes after the end of the image")
    return segments


def _read_segment(bitstream: bytes, position: int, code: int, name: str) -> tuple[Segment, int]:
    """Read the segment whose marker is at `position`; returns the position of the next marker too."""
    if code not in _ALLOWED:
        raise BitstreamError(f"{name}: marker FF{code:02X} at byte {position} is not allowed there")
    if position + 4 > len(bitstream):
        raise BitstreamError(f"{name}: ends inside the marker segment at byte {position}")
    (length,) = struct.unpack_from(">H", bitstream, position + 2)
    end = position + 2 + length
    if length < 2 or end > len(bitstream):
        raise BitstreamError(f"{name}: marker segment FF{code:02X} at byte {position} claims {length} bytes")
    content = bitstream[position + 4 : end]
    if code != SOS:
        return Segment(code, position + 4, content), end
    marker = _MARKER.search(bitstream, end)
    if marker is None:
        raise BitstreamError(f"{name}: the scan at byte {position} never ends; the file is cut short")
    return Segment(code, position + 4, content, bitstream[end : marker.start()]), marker.start()


def read_frame_header(segments: list[Segment], name: str) -> FrameHeader:
    """Read the frame header of a file. Raises BitstreamError if there is none, several or one out of range."""
    headers = [segment for segment in segments if segment.code in FRAME_HEADERS]
    if len(headers) != 1:
        raise BitstreamError(f"{name}: {len(headers)} frame headers; exactly one is read")
    code, content = headers[0].code, headers[0].content
    if len(content) < 6 or len(content) != 6 + 3 * content[5]:
        raise BitstreamError(f"{name}: the frame header has {len(content)} bytes")
    precision, height, width, count = struct.unpack_from(">BHHB", content)
    if precision != 8 or count not in (1, 3):
        raise BitstreamError(f"{name}: {count} components of {precision} bits; 1 or 3 of 8 bits are read")
    if not 0 < width * height <= MAX_PIXELS:
        raise BitstreamError(f"{name}: {width}x{height} is not within 1..{MAX_PIXELS} pixels")
    components = tuple(
        Component(content[i], content[i + 1] >> 4, content[i + 1] & 15, content[i + 2])
        for i in range(6, len(content), 3)
    )
    for component in components:
        if not (1 <= component.h <= 4 and 1 <= component.v <= 4 and component.table <= 3):
            raise BitstreamError(f"{name}: component {component} is out of range")
    if len({component.id for component in components}) != count:
        raise BitstreamError(f"{name}: two components share an identifier")
    return FrameHeader(code, width, height, components)


def check_plausible(header: FrameHeader, segments: list[Segment], name: str) -> None:
    """Raise BitstreamError for a header with more blocks than its scans have bits, before anything is allocated.

    Every block costs at least one bit: the shortest Huffman code of a DC difference.
    """
    bits = 8 * sum(len(segment.scan_data) for segment in segments)
    if header.blocks > bits:
        raise BitstreamError(f"{name}: {header.blocks} blocks cannot be coded in {bits} bits; cut short or damaged")


@dataclass(frozen=True)
class JpegQuality:
    """The libjpeg quality whose luminance table is nearest to that of a file."""

    quality: int
    """1 to 100."""
    is_exact: bool
    """Whether the tables are equal."""

    def __str__(self) -> str:
        if self.is_exact:
            return f"JPEG of quality {self.quality} (libjpeg's table)"
        return f"JPEG of about quality {self.quality} (the nearest of libjpeg's tables)"


def quality_from_jpeg(bitstream: bytes) -> JpegQuality | None:
    """Estimate the quality of a JPEG file from its table 0, that of luminance; None if there is no readable one.

    The distance of two tables is the mean log ratio of steps. Source of the scale: jpeg_quality_scaling of libjpeg.
    """
    table = _table_zero(bitstream)
    if table is None:
        return None
    scaled = np.stack([libjpeg_steps(quality) for quality in range(1, 101)])
    distances = np.abs(np.log(scaled / table)).mean(axis=1)
    best = int(distances.argmin())
    return JpegQuality(best + 1, bool((scaled[best] == table).all()))


def libjpeg_steps(quality: int) -> NDArray[np.int64]:
    """libjpeg's luminance steps (64,) in zigzag order at a quality from 1 to 100, in its baseline range."""
    percent = 5000 // quality if quality < 50 else 200 - 2 * quality
    steps = (LUMINANCE.reshape(64).astype(np.int64) * percent + 50) // 100
    return np.asarray(np.clip(steps, 1, 255)[ZIGZAG])


def _table_zero(bitstream: bytes) -> NDArray[np.int64] | None:
    try:
        segments = read_segments(bitstream.rstrip(b"\0"), "jpeg")
    except BitstreamError:
        return None
    for segment in segments:
        content = segment.content if segment.code == DQT else b""
        while content:
            wide, number = content[0] >> 4, content[0] & 15
            length = 128 if wide else 64
            table = np.frombuffer(content[1 : 1 + length], ">u2" if wide else np.uint8).astype(np.int64)
            content = content[1 + length :]
            if number == 0:
                return table if len(table) == 64 and table.min() > 0 else None
    return None
