"""The multi-level codec with a memory: of a table, only what is not in the table of the picture before is sent.

A picture that starts is a bitstream of `multilevel`. After it, little-endian:

    offset  bytes  content
         0      4  `CBMM`
         4      4  index of digit 0, int32
         8      4  R, number of digits
        12      4  entries that are kept from the table before
        16      4  sum of what is sent of their counts
        20      4  bytes of the kept entries
        24      4  new entries
        28      4  bytes of the new entries
        32         the kept entries, the new entries, the payload
    last 4         CRC-32 of all before, begun with that of the packet before: nothing decodes on another memory

Kept entries are places in the table before, the most frequent first, coded as `multilevel` codes codes; with each goes
how much its count changed. New entries are coded as `multilevel` codes tuples.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.counting.trace import NULL_TRACE
from codecbench.plugins.codecs.multilevel import entropy_coding
from codecbench.plugins.codecs.multilevel.arithmetic import decode_symbols, encode_symbols
from codecbench.plugins.codecs.multilevel.bitstream import unpack
from codecbench.plugins.codecs.multilevel.header import MAX_SYMBOLS, Header
from codecbench.plugins.codecs.multilevel.tables import decode_codes, decode_tuples, encode_codes, encode_tuples

_MAGIC: Final = b"CBMM"
_HEAD: Final = struct.Struct("<4siIIIIII")
_CRC: Final = struct.Struct("<I")
_ROOM: Final = 4096

Tuples = NDArray[np.int32]
Counts = NDArray[np.int64]


@dataclass(frozen=True)
class Memory:
    """What both ends know after a picture.

    header: of the last start. tuples: (U, g) int32, values of the quantised coefficients, in the order of the codes.
    counts: (U,) int64, how often each occurred. checksum: of the last packet.
    """

    header: Header
    tuples: Tuples
    counts: Counts
    checksum: int

    @classmethod
    def after_start(cls, bitstream: bytes) -> Self:
        """What a bitstream of `multilevel` leaves behind. Raises BitstreamError for what is none of one level."""
        parts = unpack(bitstream)
        if parts.header.levels != 1 or parts.header.search:
            raise BitstreamError("a stream starts with a picture of one level, with its tuples in the header")
        ranks, tuples = entropy_coding.decoded(parts, "greedy", NULL_TRACE)
        counts = np.bincount(ranks, minlength=len(tuples[0])).astype(np.int64)
        return cls(parts.header, tuples[0] + np.int32(parts.header.offset), counts, zlib.crc32(bitstream))

    def followed_by(self, tuples: Tuples, counts: Counts, packet: bytes) -> Self:
        """What a packet of that table leaves behind."""
        return replace(self, tuples=tuples, counts=counts, checksum=zlib.crc32(packet[: -_CRC.size], self.checksum))

    def by_frequency(self) -> NDArray[np.int64]:
        """Places in the table, the most frequent entry first."""
        return np.argsort(-self.counts, kind="stable").astype(np.int64)

    def encoded(self, tuples: Tuples, counts: Counts, ranks: NDArray[np.int32], offset: int, radix: int) -> bytes:
        """A packet of a picture with this table, ranks in it, and digits `offset` to `offset + radix - 1`."""
        order = self.by_frequency()
        known = {entry: place for place, entry in enumerate(_rows(self.tuples[order]))}
        places = np.array([known.get(entry, -1) for entry in _rows(tuples)], np.int64)
        is_new = places < 0
        kept = np.argsort(places[~is_new], kind="stable")
        kept_places = places[~is_new][kept]
        changes = _folded(counts[~is_new][kept] - self.counts[order][kept_places])
        kept_data = _coded(encode_codes, kept_places, changes) if len(kept_places) else b""
        new = np.ascontiguousarray(tuples[is_new] - np.int32(offset))
        new_data = _coded(encode_tuples, new, np.ascontiguousarray(counts[is_new])) if len(new) else b""
        payload = np.empty(4 * len(ranks) + 16, np.uint8)
        size = encode_symbols(ranks, counts, np.empty(len(counts) + 1, np.int64), payload)
        head = _HEAD.pack(
            _MAGIC, offset, radix, len(kept_places), int(changes.sum()), len(kept_data), len(new), len(new_data)
        )
        content = head + kept_data + new_data + payload[:size].tobytes()
        return content + _CRC.pack(zlib.crc32(content, self.checksum))

    def decoded(self, packet: bytes) -> tuple[Self, NDArray[np.int32]]:
        """The memory after a packet, and the ranks that it holds. Raises BitstreamError for what it does not follow."""
        content = packet[: -_CRC.size]
        if len(content) < _HEAD.size or not content.startswith(_MAGIC):
            raise BitstreamError("not a packet of this codec")
        checksum = zlib.crc32(content, self.checksum)
        if packet[-_CRC.size :] != _CRC.pack(checksum):
            raise BitstreamError("damaged, or it follows another packet than the one before it")
        _, offset, radix, kept, changed, kept_size, new, new_size = _HEAD.unpack_from(content)
        groups = -(-self.header.samples // self.header.group)
        if kept > len(self.counts) or not 1 <= kept + new <= groups or not 1 <= radix <= MAX_SYMBOLS:
            raise BitstreamError(f"{kept} kept and {new} new entries of {radix} digits are not allowed")
        middle = _HEAD.size + kept_size
        tuples, counts = self._kept(content[_HEAD.size : middle], kept, changed)
        new_data = content[middle : middle + new_size]
        fresh, fresh_counts = _new(new_data, new, radix, groups - int(counts.sum()), self.header.group)
        tuples, counts = np.vstack([tuples, fresh + np.int32(offset)]), np.concatenate([counts, fresh_counts])
        order = np.lexsort(tuples.T)  # by the last digit, then the one before it: the order of canonical codes
        memory = replace(self, tuples=np.ascontiguousarray(tuples[order]), counts=counts[order], checksum=checksum)
        return memory, memory._ranks(content[middle + new_size :], groups)

    def _kept(self, data: bytes, entries: int, changed: int) -> tuple[Tuples, Counts]:
        order = self.by_frequency()
        places, changes = np.empty(entries, np.int64), np.empty(entries, np.int64)
        if entries and _read(decode_codes, data, len(order) - 1, changed, places, changes) < 0:
            raise BitstreamError("the kept entries are damaged")
        counts = self.counts[order[places]] + _unfolded(changes)
        if entries and counts.min() < 1:
            raise BitstreamError("a kept entry that does not occur")
        return self.tuples[order[places]], counts

    def _ranks(self, payload: bytes, groups: int) -> NDArray[np.int32]:
        ranks = np.empty(groups, np.int32)
        starts = np.empty(len(self.counts) + 1, np.int64)
        if int(self.counts.sum()) != groups or _read(decode_symbols, payload, self.counts, starts, ranks) < 0:
            raise BitstreamError("the payload is damaged")
        return ranks


def _rows(tuples: Tuples) -> list[bytes]:
    """Each row as something that can be looked up."""
    size = tuples.shape[1] * tuples.itemsize
    data = np.ascontiguousarray(tuples).tobytes()
    return [data[start : start + size] for start in range(0, len(data), size)]


def _folded(changes: Counts) -> Counts:
    """0, -1, 1, -2, 2 ... as 1, 2, 3, 4, 5 ..."""
    return np.where(changes >= 0, 2 * changes + 1, -2 * changes).astype(np.int64)


def _unfolded(numbers: Counts) -> Counts:
    return np.where(numbers % 2 == 1, numbers // 2, -(numbers // 2)).astype(np.int64)


def _coded(kernel: object, entries: NDArray[np.generic], counts: Counts) -> bytes:
    """What a kernel of `tables` writes, with as much room as it needs."""
    room = _ROOM + 8 * entries.size
    while True:
        out = np.empty(room, np.uint8)
        size = kernel(entries, counts, out)  # type: ignore[operator]
        if size >= 0:
            return out[:size].tobytes()
        room *= 4


def _new(data: bytes, entries: int, radix: int, total: int, group: int) -> tuple[Tuples, Counts]:
    tuples, counts = np.empty((entries, group), np.int32), np.empty(entries, np.int64)
    if entries and _read(decode_tuples, data, radix, total, tuples, counts) < 0:
        raise BitstreamError("the new entries are damaged")
    return tuples, counts


def _read(kernel: object, data: bytes, *arguments: object) -> int:
    return int(kernel(np.frombuffer(data, np.uint8), *arguments))  # type: ignore[operator]
