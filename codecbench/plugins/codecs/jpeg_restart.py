"""Recover the complete restart intervals of a JPEG file with missing parts.

Each interval is coded independently (ITU-T T.81 E.1.4). So the complete ones together make a file of fewer rows, which
any decoder reads.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from codecbench.core.contracts.codec import Fragment
from codecbench.core.contracts.errors import BitstreamError
from codecbench.plugins.codecs.jfif import (
    DRI,
    EOI,
    FRAME_HEADERS,
    SOF_BASELINE,
    SOF_EXTENDED,
    SOS,
    FrameHeader,
    read_frame_header,
    read_segments,
)

_RST0, _CYCLE = 0xD0, 8
_END = bytes([0xFF, EOI])
_MARKERS = re.compile(rb"\xff([\xd0-\xd7\xd9])")
_HEIGHT = 1
"""Offset of the height in a frame header, behind the precision."""


@dataclass(frozen=True)
class PartialDecode:
    """The recovered part of a file."""

    file: bytes = field(repr=False)
    """A complete JPEG file of the recovered rows."""
    rows: list[int] = field(repr=False)
    """Index of each recovered row in the full image, ascending."""
    header: FrameHeader
    """Frame header of the full image."""


def salvage(fragments: Sequence[Fragment], name: str) -> PartialDecode:
    """Recover the complete intervals of a sequential file in one scan.

    Raises BitstreamError, led by the codec's `name`, if the header is missing, the file has no restart intervals of
    whole rows, or no interval is complete.
    """
    first = fragments[0]
    begin = _scan_start(first.data, name) if first.offset == 0 else 0
    if not begin:
        raise BitstreamError(f"{name}: the header is missing, so nothing can be decoded")
    segments = read_segments(first.data[:begin] + _END, name)
    header = read_frame_header(segments, name)
    intervals = [segment.content for segment in segments if segment.code == DRI]
    if header.code not in (SOF_BASELINE, SOF_EXTENDED) or segments[-1].content[:1] != bytes([len(header.components)]):
        raise BitstreamError(f"{name}: parts of a file in several scans are missing")
    mcus = struct.unpack(">H", intervals[0])[0] if len(intervals) == 1 and len(intervals[0]) == 2 else 0
    width, height = _mcu_size(header)
    per_row = -(-header.width // width)
    if not mcus or mcus % per_row:
        raise BitstreamError(f"{name}: parts are missing, and there are no restart intervals; encode with `restart`")
    step = height * mcus // per_row
    count = -(-header.height // step)
    complete = _number_intervals([*_marker_runs(fragments, begin, count, name)], count, name)
    if not complete:
        raise BitstreamError(f"{name}: none of {count} restart intervals is complete")
    rows = [row for number in complete for row in range(number * step, min((number + 1) * step, header.height))]
    place = next(segment.offset for segment in segments if segment.code in FRAME_HEADERS) + _HEIGHT
    head = first.data[:place] + struct.pack(">H", len(rows)) + first.data[place + 2 : begin]
    data = [part for index, data in enumerate(complete.values()) for part in (_restart_marker(index - 1), data)]
    return PartialDecode(head + b"".join(data[1:]) + _END, rows, header)


def _mcu_size(header: FrameHeader) -> tuple[int, int]:
    """Width and height of an MCU in pixels: one block if there is one component."""
    if len(header.components) == 1:
        return 8, 8
    return 8 * max(component.h for component in header.components), 8 * max(
        component.v for component in header.components
    )


def _restart_marker(index: int) -> bytes:
    return bytes([0xFF, _RST0 + index % _CYCLE])


def _scan_start(data: bytes, name: str) -> int:
    """Start of the entropy-coded data of the first scan; 0 if the bytes end before it."""
    position = 2
    while position + 4 <= len(data):
        if data[position] != 0xFF:
            raise BitstreamError(f"{name}: no marker at byte {position}; the header is damaged")
        end = position + 2 + int.from_bytes(data[position + 2 : position + 4], "big")
        if data[position + 1] == SOS:
            return end if end <= len(data) else 0
        position = end
    return 0


class _MarkerRun(NamedTuple):
    """Consecutive markers of one fragment, each of which begins an interval; EOI counts as one too."""

    first: int
    """Number of the first marker's interval, modulo 8."""
    marks: int
    """Number of markers."""
    data: list[bytes]
    """Data of the intervals between the markers."""
    is_end: bool
    """Whether the last marker is EOI."""


def _marker_runs(fragments: Sequence[Fragment], begin: int, count: int, name: str) -> list[_MarkerRun]:
    """Markers of each fragment that has any; the beginning of the scan counts as one."""
    runs = []
    for fragment in fragments:
        data = fragment.data if fragment.offset else fragment.data[begin:]
        marks = [] if fragment.offset else [(0, 0, 0)]
        for match in _MARKERS.finditer(data):
            code = match[1][0]
            marks.append((match.start(), match.end(), (count if code == EOI else code - _RST0 + 1) % _CYCLE))
        if not marks:
            continue
        if any((after[2] - before[2]) % _CYCLE != 1 for before, after in pairwise(marks)):
            raise BitstreamError(f"{name}: restart markers out of order; the file is damaged")
        between = [data[before[1] : after[0]] for before, after in pairwise(marks)]
        runs.append(_MarkerRun(marks[0][2], len(marks), between, data.endswith(_END)))
    return runs


def _number_intervals(runs: list[_MarkerRun], count: int, name: str) -> dict[int, bytes]:
    """Data of the complete intervals by number, if the number is certain.

    A marker gives the number modulo 8. If more than 8 intervals may be missing in a gap, its length follows from the
    total count only, provided that the end was received and no other gap is uncertain.
    """
    starts, following = [0], runs[0].marks
    for run in runs[1:]:
        starts.append(following + (run.first - following) % _CYCLE)
        following = starts[-1] + run.marks
    is_closed = runs[-1].is_end
    slack = count + is_closed - following
    if slack < 0 or (is_closed and (slack % _CYCLE or (slack and len(runs) == 1))):
        raise BitstreamError(f"{name}: {count} restart intervals do not fit their markers; the file is damaged")
    certain = set(range(len(runs)))
    if slack >= _CYCLE:
        certain = {0, len(runs) - 1} if is_closed else {0}
        starts[-1] += slack * is_closed
    return {
        start + index: data
        for place, (start, run) in enumerate(zip(starts, runs, strict=True))
        if place in certain
        for index, data in enumerate(run.data)
    }
