"""The multi-level codec as an inter-frame codec: only the difference from the last frame's table is sent.

A keyframe is a bitstream of `multilevel`. Other packets are little-endian:

    offset  bytes  content
         0      4  `CBMM`
         4      4  index of digit 0, int32
         8      4  R, number of digits
        12      4  entries that are kept from the table before
        16      4  sum of the coded changes of their counts
        20      4  bytes of the kept entries
        24      4  new entries
        28      4  bytes of the new entries
        32         the kept entries, the new entries, the payload
    last 4         CRC-32 of all before, continued from that of the packet before, so that another memory is detected

Kept entries are places in the table before, the most frequent first, coded as `multilevel` codes codes; each comes with
the change of its count. New entries are coded as `multilevel` codes tuples.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, replace
from typing import ClassVar, Final, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.codec import Capabilities, StreamCodec
from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import Image, check_image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Loss, Packet, Picture, StreamDecoder, StreamEncoder
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.dct.planes import Color
from codecbench.plugins.codecs.multilevel import entropy_coding
from codecbench.plugins.codecs.multilevel.arithmetic import decode_symbols, encode_symbols
from codecbench.plugins.codecs.multilevel.bitstream import unpack
from codecbench.plugins.codecs.multilevel.codec import Multilevel, image_from_values
from codecbench.plugins.codecs.multilevel.header import MAX_GROUP, MAX_QF, MAX_SYMBOLS, MIN_GROUP, MIN_QF, Header
from codecbench.plugins.codecs.multilevel.keys import canonical_keys, check_keys
from codecbench.plugins.codecs.multilevel.levels import Scan, expand_levels, minimize_levels
from codecbench.plugins.codecs.multilevel.tables import decode_codes, decode_tuples, encode_codes, encode_tuples

_MAGIC: Final = b"CBMM"
_HEADER: Final = struct.Struct("<4siIIIIII")
_CRC: Final = struct.Struct("<I")
_ROOM: Final = 4096

Tuples = NDArray[np.int32]
Counts = NDArray[np.int64]


@dataclass(frozen=True)
class Memory:
    """State of encoder and decoder after a frame."""

    header: Header
    """Header of the last keyframe."""
    tuples: Tuples
    """(U, g): values of the quantized coefficients, in the order of the codes."""
    counts: Counts
    """(U,): occurrences of each tuple."""
    checksum: int
    """CRC-32 of the last packet."""

    @classmethod
    def after_keyframe(cls, bitstream: bytes) -> Self:
        """Return the state after a keyframe. Raises BitstreamError if it is no bitstream of one level."""
        parts = unpack(bitstream)
        if parts.header.levels != 1 or parts.header.search:
            raise BitstreamError("a stream starts with a keyframe of one level, with its tuples in the header")
        ranks, tuples = entropy_coding.decode(parts, "greedy", NULL_TRACE)
        counts = np.bincount(ranks, minlength=len(tuples[0])).astype(np.int64)
        return cls(parts.header, tuples[0] + np.int32(parts.header.offset), counts, zlib.crc32(bitstream))

    def after_packet(self, tuples: Tuples, counts: Counts, packet: bytes) -> Self:
        """Return the state after a packet of this table."""
        return replace(self, tuples=tuples, counts=counts, checksum=zlib.crc32(packet[: -_CRC.size], self.checksum))

    def frequency_order(self) -> NDArray[np.int64]:
        """Order the entries of the table by frequency, the most frequent first."""
        return np.argsort(-self.counts, kind="stable").astype(np.int64)

    def encode(self, tuples: Tuples, counts: Counts, ranks: NDArray[np.int32], offset: int, radix: int) -> bytes:
        """Encode a frame with this table, ranks in it, and digits `offset` to `offset + radix - 1`."""
        order = self.frequency_order()
        known = {entry: place for place, entry in enumerate(_rows(self.tuples[order]))}
        places = np.array([known.get(entry, -1) for entry in _rows(tuples)], np.int64)
        is_new = places < 0
        by_place = np.argsort(places[~is_new], kind="stable")
        kept_places = places[~is_new][by_place]
        changes = _fold(counts[~is_new][by_place] - self.counts[order][kept_places])
        kept_data = _encode_with(encode_codes, kept_places, changes) if len(kept_places) else b""
        new = np.ascontiguousarray(tuples[is_new] - np.int32(offset))
        new_data = _encode_with(encode_tuples, new, np.ascontiguousarray(counts[is_new])) if len(new) else b""
        payload = np.empty(4 * len(ranks) + 16, np.uint8)
        size = encode_symbols(ranks, counts, np.empty(len(counts) + 1, np.int64), payload)
        head = _HEADER.pack(
            _MAGIC, offset, radix, len(kept_places), int(changes.sum()), len(kept_data), len(new), len(new_data)
        )
        content = head + kept_data + new_data + payload[:size].tobytes()
        return content + _CRC.pack(zlib.crc32(content, self.checksum))

    def decode(self, packet: bytes) -> tuple[Self, NDArray[np.int32]]:
        """Decode a packet; returns the next state and the ranks. Raises BitstreamError if it follows another state."""
        content = packet[: -_CRC.size]
        if len(content) < _HEADER.size or not content.startswith(_MAGIC):
            raise BitstreamError("not a packet of this codec")
        checksum = zlib.crc32(content, self.checksum)
        if packet[-_CRC.size :] != _CRC.pack(checksum):
            raise BitstreamError("damaged, or it does not follow the packet before it")
        _, offset, radix, kept_count, changed, kept_size, new_count, new_size = _HEADER.unpack_from(content)
        groups = -(-self.header.samples // self.header.group)
        if kept_count > len(self.counts) or not 1 <= kept_count + new_count <= groups or not 1 <= radix <= MAX_SYMBOLS:
            raise BitstreamError(f"{kept_count} kept and {new_count} new entries of {radix} digits are not allowed")
        middle = _HEADER.size + kept_size
        kept, kept_counts = self._read_kept(content[_HEADER.size : middle], kept_count, changed)
        new_data = content[middle : middle + new_size]
        new, new_counts = _read_new(new_data, new_count, radix, groups - int(kept_counts.sum()), self.header.group)
        tuples, counts = np.vstack([kept, new + np.int32(offset)]), np.concatenate([kept_counts, new_counts])
        order = np.lexsort(tuples.T)  # by the last digit, then the one before it: the order of canonical codes
        memory = replace(self, tuples=np.ascontiguousarray(tuples[order]), counts=counts[order], checksum=checksum)
        return memory, memory._read_ranks(content[middle + new_size :], groups)

    def _read_kept(self, data: bytes, entries: int, changed: int) -> tuple[Tuples, Counts]:
        order = self.frequency_order()
        places, changes = np.empty(entries, np.int64), np.empty(entries, np.int64)
        if entries and _decode_with(decode_codes, data, len(order) - 1, changed, places, changes) < 0:
            raise BitstreamError("the kept entries are damaged")
        counts = self.counts[order[places]] + _unfold(changes)
        if entries and counts.min() < 1:
            raise BitstreamError("a kept entry without occurrences")
        return self.tuples[order[places]], counts

    def _read_ranks(self, payload: bytes, groups: int) -> NDArray[np.int32]:
        ranks = np.empty(groups, np.int32)
        starts = np.empty(len(self.counts) + 1, np.int64)
        if int(self.counts.sum()) != groups or _decode_with(decode_symbols, payload, self.counts, starts, ranks) < 0:
            raise BitstreamError("the payload is damaged")
        return ranks


def _rows(tuples: Tuples) -> list[bytes]:
    """Convert each row to a dictionary key."""
    size = tuples.shape[1] * tuples.itemsize
    data = np.ascontiguousarray(tuples).tobytes()
    return [data[start : start + size] for start in range(0, len(data), size)]


def _fold(changes: Counts) -> Counts:
    """Map 0, -1, 1, -2, 2 ... to 1, 2, 3, 4, 5 ..."""
    return np.where(changes >= 0, 2 * changes + 1, -2 * changes).astype(np.int64)


def _unfold(numbers: Counts) -> Counts:
    return np.where(numbers % 2 == 1, numbers // 2, -(numbers // 2)).astype(np.int64)


def _encode_with(kernel: object, entries: NDArray[np.generic], counts: Counts) -> bytes:
    """Encode with a kernel of `tables`, with as much room as it needs."""
    room = _ROOM + 8 * entries.size
    while True:
        out = np.empty(room, np.uint8)
        size = kernel(entries, counts, out)  # type: ignore[operator]
        if size >= 0:
            return out[:size].tobytes()
        room *= 4


def _read_new(data: bytes, entries: int, radix: int, total: int, group: int) -> tuple[Tuples, Counts]:
    tuples, counts = np.empty((entries, group), np.int32), np.empty(entries, np.int64)
    if entries and _decode_with(decode_tuples, data, radix, total, tuples, counts) < 0:
        raise BitstreamError("the new entries are damaged")
    return tuples, counts


def _decode_with(kernel: object, data: bytes, *arguments: object) -> int:
    return int(kernel(np.frombuffer(data, np.uint8), *arguments))  # type: ignore[operator]


class MultilevelStreamParams(Params):
    """Set `multilevel` with one level, canonical keys and tuples in the header, and the keyframe interval."""

    qf: float = Field(5.0, ge=MIN_QF, le=MAX_QF, description="factor on the quantization table")
    group: int = Field(3, ge=MIN_GROUP, le=MAX_GROUP, description="digits combined into one code")
    color: Color = Field("rgb", description="planes of a color image; a gray image is always one plane")
    scan: Scan = Field("block", description="coefficients block by block, or frequency by frequency")
    gop: int = Field(30, ge=1, le=1000, description="frames from one keyframe to the next")


class MultilevelStream(StreamCodec[MultilevelStreamParams]):
    """`multilevel` with memory: the same decoded frames to the bit, and tables that build on the one before.

    Only the table is predicted, so the difference in size from `multilevel` shows what this memory is worth.
    """

    name: ClassVar[str] = "multilevel_stream"
    version: ClassVar[str] = "1"
    params_type = MultilevelStreamParams
    capabilities: ClassVar[Capabilities] = Capabilities()
    kernels: tuple[str, ...] = Multilevel.kernels
    examples = ({}, {"qf": 20, "color": "ycbcr420", "gop": 5}, {"qf": 75, "group": 2, "scan": "coefficient"})

    def __init__(self, params: MultilevelStreamParams) -> None:
        super().__init__(params)
        self.kernels = (*_intra_codec(params).kernels, "codecbench.plugins.codecs.multilevel.tables")

    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return MultilevelEncoder(self.params)

    def decoder(self) -> StreamDecoder:
        return MultilevelDecoder()


def _intra_codec(params: MultilevelStreamParams) -> Multilevel:
    """The codec of keyframes."""
    return Multilevel.create(**params.model_dump(exclude={"gop"}))


class MultilevelEncoder(StreamEncoder):
    """An encoding session."""

    def __init__(self, params: MultilevelStreamParams) -> None:
        self._gop, self._group = params.gop, params.group
        self._intra_codec = _intra_codec(params)
        self._memory: Memory | None = None
        self._shape: tuple[int, ...] = ()
        self._pushed = 0

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        image = check_image(image)
        if self._memory is not None and image.shape != self._shape:
            raise ImageError(f"a frame of shape {image.shape} in a stream of shape {self._shape}")
        frame = self._pushed
        if self._memory is None or frame % self._gop == 0:
            data = self._intra_codec.encode(image)
            self._memory, self._shape = Memory.after_keyframe(data), image.shape
        else:
            data = self._encode_after(self._memory, image)
        self._pushed += 1
        return [Packet(data, frame, starts=frame % self._gop == 0)]

    def flush(self) -> list[Packet]:
        return []

    def _encode_after(self, memory: Memory, image: Image) -> bytes:
        values = self._intra_codec.values_of(image, memory.header, NULL_TRACE)
        minimized = minimize_levels(
            values, 1, lambda level, radix: check_keys(canonical_keys(radix, self._group), radix, level), NULL_TRACE
        )
        (table,) = minimized.tables
        tuples = table.tuples + np.int32(minimized.offset)
        data = memory.encode(tuples, table.counts, minimized.ranks, minimized.offset, table.radix)
        self._memory = memory.after_packet(tuples, table.counts, data)
        return data


class MultilevelDecoder(StreamDecoder):
    """A decoding session: frames are whole, or missing from a loss to the next keyframe."""

    def __init__(self) -> None:
        self._intra_codec = Multilevel.create()
        self._memory: Memory | None = None
        self._next = 0

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        frame = self._next if isinstance(packet, Loss) else packet.frame
        self._next = frame + 1
        memory, self._memory = self._memory, None  # None after a loss or an error
        if isinstance(packet, Loss):
            return [Picture(frame, "missing", None)]
        if packet.starts:
            self._memory = Memory.after_keyframe(packet.data)
            return [Picture(frame, "whole", self._intra_codec.decode(packet.data))]
        if memory is None:
            return [Picture(frame, "missing", None)]
        self._memory, ranks = memory.decode(packet.data)
        header = memory.header
        values = expand_levels(ranks, [self._memory.tuples], 0, header.samples, NULL_TRACE)
        return [Picture(frame, "whole", image_from_values(values, header, NULL_TRACE))]

    def flush(self) -> list[Picture]:
        return []
