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
from codecbench.plugins.codecs.multilevel.context.binary import (
    ENCODING,
    POSITION,
    finish,
    new_coder,
    start_decoding,
)
from codecbench.plugins.codecs.orb_features.coding import (
    CODED,
    MAX_LEVELS,
    MOST_BYTES,
    NO_CANDIDATE,
    OUTSIDE,
    RAW,
    code_lengths,
    code_parts,
    code_set,
    new_model,
)
from codecbench.plugins.codecs.orb_features.descriptors import (
    END,
    LANES,
    MOST_WORDS,
    UNWRITTEN_WORDS,
    WORD_BITS,
    code_descriptors,
    finish_lanes,
    new_lanes,
    start_lanes,
)
from codecbench.plugins.codecs.orb_features.keypoints import PARTS, CodedKeypoints, grid_of
from codecbench.plugins.codecs.orb_features.prediction import BIASES, NIBBLES

MAX_KEYPOINTS = 10_000
MAX_ANGLE_BITS = 30
MAX_STEP = 64
MAX_LIKE = 80

_MAGIC = b"CBOF"
_VERSION = 3
_VERSION_OF_PIXELS = 2  # has no parts; read as ever
_STARTS, _CODED, _PARTS = 1, 2, 4
_FIXED = struct.Struct("<4sBBHHBBBBI")
_WORD = struct.Struct("<I")
_WORD_BYTES = WORD_BITS // 8
_ONES = np.full((1, 4), 2**64 - 1, np.uint64)
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
    coder, data = new_coder(True, 0), np.empty(MOST_BYTES * (len(found) + LANES + 1), np.uint8)
    work = _Work(memory, found.descriptors, coded, like)
    work.code_set(coder, data, found)
    lanes = work.encode_lanes(coder, data) if coded else found.descriptors.astype("<u8").tobytes()
    payload = data[: finish(coder, data)].tobytes() + lanes
    grid = found.grid
    flags = (_STARTS if starts else 0) | (_CODED if coded else 0) | (_PARTS if grid.parts > 1 else 0)
    header = _FIXED.pack(
        _MAGIC, _VERSION, flags, grid.width, grid.height, grid.levels, grid.step, found.angle_bits, like,
        memory.checksum,
    )  # fmt: skip
    counts = np.diff(found.octave_starts).astype("<u2").tobytes()
    content = header + counts + payload
    checksum = zlib.crc32(content)
    return content + _WORD.pack(checksum), work.memory_after(found, checksum)


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
        ("version", version, version in (_VERSION_OF_PIXELS, _VERSION)),
        ("flags", flags, flags & ~(_STARTS | _CODED | (_PARTS if version == _VERSION else 0)) == 0),
        ("size", (width, height), 0 < width * height <= MAX_PIXELS),
        ("levels", levels, 1 <= levels <= MAX_LEVELS),
        ("step", step, 1 <= step <= MAX_STEP),
        ("bits of an angle", angle_bits, 1 <= angle_bits <= MAX_ANGLE_BITS),
        ("bits of copies", like, like <= MAX_LIKE),
    ):
        if not is_allowed:
            raise BitstreamError(f"orb_features: header: {name} {value} is not allowed")
    starts, coded = bool(flags & _STARTS), bool(flags & _CODED)
    if not starts and (memory is None or memory.checksum != before or memory.angle_bits != angle_bits):
        return None
    memory = Memory.empty() if starts or memory is None else memory
    if len(content) < _FIXED.size + 2 * levels:
        raise BitstreamError(f"orb_features: cut off: {len(content)} bytes do not hold the counts of {levels} levels")
    counts = np.frombuffer(content[_FIXED.size : _FIXED.size + 2 * levels], "<u2").astype(np.int64)
    total = int(counts.sum())
    if total > MAX_KEYPOINTS:
        raise BitstreamError(f"orb_features: header: {total} keypoints; at most {MAX_KEYPOINTS} are allowed")
    coder, data = new_coder(True, 0), np.frombuffer(bytearray(content[_FIXED.size + 2 * levels :]), np.uint8)
    start_decoding(coder, data)
    work = _Work(memory, np.zeros((total, 4), np.uint64), coded, like)
    found = CodedKeypoints(
        grid_of(width, height, levels, step, PARTS if flags & _PARTS else 1), angle_bits,
        np.concatenate([[0], np.cumsum(counts)]), np.zeros(total, np.int64), np.zeros(total, np.int64),
        np.zeros(total, np.int64), work.descriptors,
    )  # fmt: skip
    wrong = work.code_set(coder, data, found)
    if wrong:
        raise BitstreamError(f"orb_features: damaged: {_REASONS[wrong]}")
    if not (work.decode_lanes(coder, data) if coded else work.read_raw(coder, data)):
        raise BitstreamError("orb_features: damaged: the payload does not end where its keypoints do")
    return Unpacked(found, work.memory_after(found, checksum), starts)


class _Work:
    """A set being coded.

    known: (M + N + 1, 4): descriptors of the set before, of this one, and one of ones; see `code_descriptors`.
    """

    def __init__(self, memory: Memory, descriptors: NDArray[np.uint64], coded: bool, like: int) -> None:
        count = len(descriptors)
        self._memory, self._mode, self._like = memory, CODED if coded else RAW, like
        self._before = len(memory.descriptors)
        self._known = np.concatenate([memory.descriptors, descriptors, _ONES])
        self._places = np.zeros((count, 2), np.int64)
        self._sources, self._copied = np.zeros(count, np.int64), np.zeros(count, np.bool_)

    @property
    def descriptors(self) -> NDArray[np.uint64]:
        """(N, 4): of this set, as a decoder has them."""
        return self._known[self._before : -1]

    def memory_after(self, found: CodedKeypoints, checksum: int) -> Memory:
        """What is remembered of the set."""
        return Memory(
            self._memory.model, found.octave_starts, self._places, found.angles, self.descriptors, found.angle_bits,
            checksum,
        )  # fmt: skip

    def code_set(self, coder: NDArray[np.int64], data: NDArray[np.uint8], found: CodedKeypoints) -> int:
        """All but the descriptors; returns as the kernel."""
        last = self._memory
        cells, angles = (found.cells.copy(), found.angles.copy()) if coder[ENCODING] else (found.cells, found.angles)
        wrong = int(
            code_set(
                coder, data, last.model, found.grid.level_units, found.octave_starts, cells, self._places, angles,
                self._known, self._sources, self._copied, found.angle_bits, self._mode, self._like,
                last.octave_starts, last.places, last.angles,
            )
        )  # fmt: skip
        if found.grid.parts > 1 and not wrong:
            code_parts(coder, data, last.model, found.parts.copy() if coder[ENCODING] else found.parts)
        return wrong

    def encode_lanes(self, coder: NDArray[np.int64], data: NDArray[np.uint8]) -> bytes:
        """The words of all lanes; their lengths are coded."""
        lanes, room = new_lanes(), MOST_WORDS * (len(self._sources) + 1)
        starts = np.arange(LANES) * room
        words = np.empty(LANES * room, np.uint32)
        lanes[:, POSITION] = starts
        self._code_descriptors(True, lanes, words)
        finish_lanes(lanes, words)
        lengths = lanes[:, POSITION] - starts
        code_lengths(coder, data, self._memory.model, lengths)
        written = np.concatenate([words[start : start + n] for start, n in zip(starts, lengths, strict=True)])
        return written.astype("<u4").view(np.uint8).reshape(-1, 4)[:, :_WORD_BYTES].tobytes()

    def decode_lanes(self, coder: NDArray[np.int64], data: NDArray[np.uint8]) -> bool:
        """Whether every lane, and with the last the payload, ends where its descriptors do."""
        lengths = np.zeros(LANES, np.int64)
        code_lengths(coder, data, self._memory.model, lengths)
        written = data[max(int(coder[POSITION]) - UNWRITTEN, 0) :]
        if len(written) != _WORD_BYTES * int(lengths.sum()):
            return False
        lanes, bytes_of_words = new_lanes(), np.zeros((len(written) // _WORD_BYTES, 4), np.uint8)
        bytes_of_words[:, :_WORD_BYTES] = written.reshape(-1, _WORD_BYTES)
        words = bytes_of_words.view("<u4")[:, 0].astype(np.uint32)
        lanes[:, END] = np.cumsum(lengths)
        lanes[:, POSITION] = lanes[:, END] - lengths
        start_lanes(lanes, words)
        self._code_descriptors(False, lanes, words)
        return np.array_equal(lanes[:, POSITION], lanes[:, END] + UNWRITTEN_WORDS)

    def _code_descriptors(self, encoding: bool, lanes: NDArray[np.int64], words: NDArray[np.uint32]) -> None:
        code_descriptors(
            encoding, lanes, words, NIBBLES, BIASES, self._known, self._before, self._sources, self._copied
        )

    def read_raw(self, coder: NDArray[np.int64], data: NDArray[np.uint8]) -> bool:
        """Whether the payload ends with descriptors as they are, which are then in place."""
        written = data[max(int(coder[POSITION]) - UNWRITTEN, 0) :]
        if len(written) != self.descriptors.nbytes:
            return False
        self.descriptors[:] = np.frombuffer(written.tobytes(), "<u8").reshape(-1, 4)
        return True
