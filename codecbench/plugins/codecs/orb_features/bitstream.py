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
_PIXEL_VERSION = 2  # without parts; still read
_KEYFRAME, _CODED, _PARTS = 1, 2, 4
_FIXED = struct.Struct("<4sBBHHBBBBI")
_WORD = struct.Struct("<I")
_WORD_BYTES = WORD_BITS // 8
_ONES = np.full((1, 4), 2**64 - 1, np.uint64)
_REASONS = {OUTSIDE: "a position is outside its level", NO_CANDIDATE: "a reference is missing"}


@dataclass
class Memory:
    """State of a session after a packet: the contexts and the last set."""

    model: NDArray[np.int32]
    """Context model, as `coding.new_model`."""
    octave_starts: NDArray[np.int64]
    places: NDArray[np.int64]
    """(N, 2): x and y of each keypoint in 1/PLACE_UNIT pixels of the image."""
    angles: NDArray[np.int64]
    descriptors: NDArray[np.uint64]
    angle_bits: int = 0
    checksum: int = 0
    """CRC-32 of the last packet."""

    @classmethod
    def empty(cls) -> Memory:
        """Return the state before a keyframe."""
        return cls(
            new_model(), np.zeros(1, np.int64), np.zeros((0, 2), np.int64), np.zeros(0, np.int64),
            np.zeros((0, 4), np.uint64),
        )  # fmt: skip


@dataclass(frozen=True)
class UnpackedSet:
    """Content of a packet."""

    coded: CodedKeypoints
    memory: Memory
    """State after the packet."""
    starts: bool
    """Whether the packet is a keyframe."""


def pack(keypoints: CodedKeypoints, memory: Memory | None, coded: bool, like: int) -> tuple[bytes, Memory]:
    """Encode a set after `memory`, None for a keyframe; returns the packet and the state after it.

    coded: whether descriptors are coded, not raw. like: descriptors that differ from a reference in at most so many
    bits become equal to it.
    """
    starts = memory is None
    memory = memory or Memory.empty()
    coder, data = new_coder(True, 0), np.empty(MOST_BYTES * (len(keypoints) + LANES + 1), np.uint8)
    work = _SetCoder(memory, keypoints.descriptors, coded, like)
    work.code_set(coder, data, keypoints)
    lanes = work.encode_lanes(coder, data) if coded else keypoints.descriptors.astype("<u8").tobytes()
    payload = data[: finish(coder, data)].tobytes() + lanes
    grid = keypoints.grid
    flags = (_KEYFRAME if starts else 0) | (_CODED if coded else 0) | (_PARTS if grid.parts > 1 else 0)
    header = _FIXED.pack(
        _MAGIC, _VERSION, flags, grid.width, grid.height, grid.levels, grid.step, keypoints.angle_bits, like,
        memory.checksum,
    )  # fmt: skip
    counts = np.diff(keypoints.octave_starts).astype("<u2").tobytes()
    content = header + counts + payload
    checksum = zlib.crc32(content)
    return content + _WORD.pack(checksum), work.memory_after(keypoints, checksum)


def unpack(packet: bytes, memory: Memory | None) -> UnpackedSet | None:
    """Decode a packet; None if it follows another set than that of `memory`, which is modified.

    Raises BitstreamError for damaged or foreign bytes.
    """
    if len(packet) < _FIXED.size + _WORD.size or packet[:4] != _MAGIC:
        raise BitstreamError("orb_features: not a packet of features, or cut off")
    content, checksum = packet[: -_WORD.size], zlib.crc32(packet[: -_WORD.size])
    if _WORD.unpack(packet[-_WORD.size :])[0] != checksum:
        raise BitstreamError("orb_features: damaged: the CRC-32 is wrong")
    _, version, flags, width, height, levels, step, angle_bits, like, before = _FIXED.unpack_from(content)
    for name, value, is_allowed in (
        ("version", version, version in (_PIXEL_VERSION, _VERSION)),
        ("flags", flags, flags & ~(_KEYFRAME | _CODED | (_PARTS if version == _VERSION else 0)) == 0),
        ("size", (width, height), 0 < width * height <= MAX_PIXELS),
        ("levels", levels, 1 <= levels <= MAX_LEVELS),
        ("step", step, 1 <= step <= MAX_STEP),
        ("bits of an angle", angle_bits, 1 <= angle_bits <= MAX_ANGLE_BITS),
        ("bits of copies", like, like <= MAX_LIKE),
    ):
        if not is_allowed:
            raise BitstreamError(f"orb_features: header: {name} {value} is not allowed")
    starts, coded = bool(flags & _KEYFRAME), bool(flags & _CODED)
    if not starts and (memory is None or memory.checksum != before or memory.angle_bits != angle_bits):
        return None
    memory = Memory.empty() if starts or memory is None else memory
    if len(content) < _FIXED.size + 2 * levels:
        raise BitstreamError(
            f"orb_features: cut off: {len(content)} bytes are too few for the counts of {levels} levels"
        )
    counts = np.frombuffer(content[_FIXED.size : _FIXED.size + 2 * levels], "<u2").astype(np.int64)
    total = int(counts.sum())
    if total > MAX_KEYPOINTS:
        raise BitstreamError(f"orb_features: header: {total} keypoints; at most {MAX_KEYPOINTS} are allowed")
    coder, data = new_coder(True, 0), np.frombuffer(bytearray(content[_FIXED.size + 2 * levels :]), np.uint8)
    start_decoding(coder, data)
    work = _SetCoder(memory, np.zeros((total, 4), np.uint64), coded, like)
    keypoints = CodedKeypoints(
        grid_of(width, height, levels, step, PARTS if flags & _PARTS else 1), angle_bits,
        np.concatenate([[0], np.cumsum(counts)]), np.zeros(total, np.int64), np.zeros(total, np.int64),
        np.zeros(total, np.int64), work.descriptors,
    )  # fmt: skip
    fault = work.code_set(coder, data, keypoints)
    if fault:
        raise BitstreamError(f"orb_features: damaged: {_REASONS[fault]}")
    if not (work.decode_lanes(coder, data) if coded else work.read_raw(coder, data)):
        raise BitstreamError("orb_features: damaged: the payload does not end with its last keypoint")
    return UnpackedSet(keypoints, work.memory_after(keypoints, checksum), starts)


class _SetCoder:
    """Encodes or decodes one set.

    _known (M + N + 1, 4) are the descriptors of the last set, of this one, and one of all ones; see `code_descriptors`.
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
        """Descriptors (N, 4) of this set, as decoded."""
        return self._known[self._before : -1]

    def memory_after(self, keypoints: CodedKeypoints, checksum: int) -> Memory:
        """Return the state after the set."""
        return Memory(
            self._memory.model, keypoints.octave_starts, self._places, keypoints.angles, self.descriptors,
            keypoints.angle_bits, checksum,
        )  # fmt: skip

    def code_set(self, coder: NDArray[np.int64], data: NDArray[np.uint8], keypoints: CodedKeypoints) -> int:
        """Code all but the descriptors; returns the result of `coding.code_set`."""
        last = self._memory
        cells, angles = (
            (keypoints.cells.copy(), keypoints.angles.copy())
            if coder[ENCODING]
            else (keypoints.cells, keypoints.angles)
        )
        fault = int(
            code_set(
                coder, data, last.model, keypoints.grid.level_units, keypoints.octave_starts, cells, self._places,
                angles, self._known, self._sources, self._copied, keypoints.angle_bits, self._mode, self._like,
                last.octave_starts, last.places, last.angles,
            )
        )  # fmt: skip
        if keypoints.grid.parts > 1 and not fault:
            code_parts(coder, data, last.model, keypoints.parts.copy() if coder[ENCODING] else keypoints.parts)
        return fault

    def encode_lanes(self, coder: NDArray[np.int64], data: NDArray[np.uint8]) -> bytes:
        """Encode the descriptors and the lanes' lengths; returns the words of all lanes."""
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
        """Decode the descriptors; returns whether every lane and the payload end with them."""
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
        """Read raw descriptors; returns whether the payload ends with them."""
        written = data[max(int(coder[POSITION]) - UNWRITTEN, 0) :]
        if len(written) != self.descriptors.nbytes:
            return False
        self.descriptors[:] = np.frombuffer(written.tobytes(), "<u8").reshape(-1, 4)
        return True
