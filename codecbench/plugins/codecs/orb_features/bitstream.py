"""The packet of a set of keypoints: header, one payload, CRC-32."""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import MAX_PIXELS
from codecbench.plugins.codecs.multilevel.arithmetic import UNWRITTEN
from codecbench.plugins.codecs.multilevel.context.binary import POSITION, finish, new_coder, start_decoding
from codecbench.plugins.codecs.orb_features.coding import (
    CODED,
    MAX_LEVELS,
    MOST_BYTES,
    NO_CANDIDATE,
    OUTSIDE,
    RAW,
    code_set,
    new_model,
)
from codecbench.plugins.codecs.orb_features.keypoints import CodedKeypoints, Grid
from codecbench.plugins.codecs.orb_features.prediction import BIASES, WEIGHTS

MAX_KEYPOINTS = 10_000
MAX_ANGLE_BITS = 30
MAX_STEP = 64
MAX_LIKE = 80

_MAGIC = b"CBOF"
_VERSION = 1
_STARTS, _CODED = 1, 2
_FIXED = struct.Struct("<4sBBHHBBBBI")
_WORD = struct.Struct("<I")
_REASONS = {OUTSIDE: "a place is outside its level", NO_CANDIDATE: "a reference is not there"}


@dataclass
class Memory:
    """What a session keeps of the sets before: contexts, the last set with its places, and its packet's CRC-32."""

    model: NDArray[np.int32]
    octave_starts: NDArray[np.int64]
    places: NDArray[np.int64]
    angles: NDArray[np.int64]
    descriptors: NDArray[np.uint64]
    angle_bits: int = 0
    checksum: int = 0

    @classmethod
    def empty(cls) -> Memory:
        """What a packet that starts is coded with."""
        return cls(
            new_model(), np.zeros(1, np.int64), np.zeros((0, 2), np.int64), np.zeros(0, np.int64),
            np.zeros((0, 4), np.uint64),
        )  # fmt: skip


@dataclass(frozen=True)
class Unpacked:
    """What a packet holds, and what is remembered after it; starts: it needed nothing from before."""

    coded: CodedKeypoints
    memory: Memory
    starts: bool


def pack(found: CodedKeypoints, memory: Memory | None, coded: bool, like: int) -> tuple[bytes, Memory]:
    """The packet of a set, after those in `memory`; None for one that starts. Returns what is then remembered.

    coded: descriptors are coded, not raw. like: those that differ from a reference in so few bits become it.
    """
    starts = memory is None
    memory = memory or Memory.empty()
    descriptors, places = found.descriptors.copy(), np.zeros((len(found), 2), np.int64)
    coder, data = new_coder(True, 0), np.zeros(MOST_BYTES * (len(found) + 1), np.uint8)
    _run(coder, data, memory, found.grid, found.octave_starts, found.cells.copy(), places, found.angles.copy(),
         descriptors, found.angle_bits, coded, like)  # fmt: skip
    payload = data[: finish(coder, data)].tobytes()
    grid, flags = found.grid, (_STARTS if starts else 0) | (_CODED if coded else 0)
    header = _FIXED.pack(
        _MAGIC, _VERSION, flags, grid.width, grid.height, grid.levels, grid.step, found.angle_bits, like,
        memory.checksum,
    )  # fmt: skip
    counts = np.diff(found.octave_starts).astype("<u2").tobytes()
    content = header + counts + payload
    checksum = zlib.crc32(content)
    after = Memory(memory.model, found.octave_starts, places, found.angles, descriptors, found.angle_bits, checksum)
    return content + _WORD.pack(checksum), after


def unpack(packet: bytes, memory: Memory | None) -> Unpacked | None:
    """The set of a packet; None where it needs another set before than that of `memory`, which is used up.

    Raises BitstreamError for damaged or foreign bytes.
    """
    if len(packet) < _FIXED.size + _WORD.size or packet[:4] != _MAGIC:
        raise BitstreamError("orb_features: not a packet of features, or cut off")
    content, checksum = packet[: -_WORD.size], zlib.crc32(packet[: -_WORD.size])
    if _WORD.unpack(packet[-_WORD.size :])[0] != checksum:
        raise BitstreamError("orb_features: damaged: the CRC-32 is wrong")
    _, version, flags, width, height, levels, step, angle_bits, like, before = _FIXED.unpack_from(content)
    for name, value, is_allowed in (
        ("version", version, version == _VERSION),
        ("flags", flags, flags & ~(_STARTS | _CODED) == 0),
        ("size", (width, height), 0 < width * height <= MAX_PIXELS),
        ("levels", levels, 1 <= levels <= MAX_LEVELS),
        ("step", step, 1 <= step <= MAX_STEP),
        ("bits of an angle", angle_bits, 1 <= angle_bits <= MAX_ANGLE_BITS),
        ("bits of copies", like, like <= MAX_LIKE),
    ):
        if not is_allowed:
            raise BitstreamError(f"orb_features: header: {name} {value} is not allowed")
    starts = bool(flags & _STARTS)
    if not starts and (memory is None or memory.checksum != before or memory.angle_bits != angle_bits):
        return None
    memory = Memory.empty() if starts or memory is None else memory
    counts = np.frombuffer(content[_FIXED.size : _FIXED.size + 2 * levels], "<u2").astype(np.int64)
    total = int(counts.sum())
    if len(counts) != levels or total > MAX_KEYPOINTS:
        raise BitstreamError(f"orb_features: header: {total} keypoints; at most {MAX_KEYPOINTS} are allowed")
    payload = content[_FIXED.size + 2 * levels :]
    octave_starts = np.concatenate([[0], np.cumsum(counts)])
    grid = Grid(width, height, levels, step)
    cells, angles = np.zeros(total, np.int64), np.zeros(total, np.int64)
    places, descriptors = np.zeros((total, 2), np.int64), np.zeros((total, 4), np.uint64)
    coder, data = new_coder(True, 0), np.frombuffer(bytearray(payload), np.uint8)
    start_decoding(coder, data)
    wrong = _run(coder, data, memory, grid, octave_starts, cells, places, angles, descriptors, angle_bits,
                 bool(flags & _CODED), like)  # fmt: skip
    if wrong:
        raise BitstreamError(f"orb_features: damaged: {_REASONS[wrong]}")
    if int(coder[POSITION]) != len(payload) + UNWRITTEN:
        raise BitstreamError("orb_features: damaged: the payload does not end where its keypoints do")
    found = CodedKeypoints(grid, angle_bits, octave_starts, cells, angles, descriptors)
    after = Memory(memory.model, octave_starts, places, angles, descriptors, angle_bits, checksum)
    return Unpacked(found, after, starts)


def _run(
    coder: NDArray[np.int64], data: NDArray[np.uint8], memory: Memory, grid: Grid, octave_starts: NDArray[np.int64],
    cells: NDArray[np.int64], places: NDArray[np.int64], angles: NDArray[np.int64], descriptors: NDArray[np.uint64],
    angle_bits: int, coded: bool, like: int,
) -> int:  # fmt: skip
    return int(
        code_set(
            coder, data, memory.model, WEIGHTS, BIASES, grid.level_units, octave_starts, cells, places, angles,
            descriptors, angle_bits, CODED if coded else RAW, like,
            memory.octave_starts, memory.places, memory.angles, memory.descriptors,
        )
    )  # fmt: skip
