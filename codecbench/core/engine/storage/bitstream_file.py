"""The file of a coding job's bitstreams, with a checksum per frame and one over the whole file.

    magic | job id | bitstream 0 | bitstream 1 | ... | index: offset, size, CRC-32 of each | footer

The job id identifies sequence and codec setting, so that two swapped files are noticed. The footer gives the offset of
the index and carries CRCs of the index and of itself. A torn or damaged file is thus noticed when it is opened, and a
damaged bitstream when it is read. The footer also has a BLAKE2b digest of everything before it, so that copies can be
compared by their last bytes.

A stream of an inter-frame codec has a different magic, and its packets are in sending order. Each index entry adds the
frame, after how many frames the packet came out, and whether decoding can start at it. For recovery points it adds
after how many frames pictures are whole; earlier files, with another magic, lack that. This module does not know
codecs.

Beside each file is a note of which code of the codec wrote it.
"""

from __future__ import annotations

import hashlib
import json
import mmap
import os
import struct
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

from codecbench.core.contracts.errors import StoreError
from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.engine.identity import DIGEST_BYTES, digest, json_from_bytes
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.storage.plain_file import open_plain, read_plain
from codecbench.core.engine.text import clean_line

_MAGIC = b"CBBITS\x00\x02"
_EARLIER = b"CBBITS\x00\x01"
_STREAM = b"CBSTRM\x00\x02"
_EARLIER_STREAM = b"CBSTRM\x00\x01"
_ID_BYTES = 2 * DIGEST_BYTES
_ENTRY = struct.Struct("<QQI")
_STREAM_ENTRY = struct.Struct("<QQIII?i")
_EARLIER_STREAM_ENTRY = struct.Struct("<QQIII?")
_NO_RECOVERY = -1
_FOOTER = struct.Struct("<QQI16sI")
_START = len(_MAGIC) + _ID_BYTES


class BitstreamDamage(StoreError):
    """Raised for a truncated or damaged bitstream file; the engine encodes the sequence again."""


@dataclass(frozen=True)
class CodedPacket:
    """A packet as stored: the fields of SentPacket, and the bytes."""

    data: bytes = field(repr=False)
    frame: int
    starts: bool
    after: int
    recovery_frames: int | None = None

    @property
    def sent_packet(self) -> SentPacket:
        """The packet without its bytes."""
        return SentPacket(self.frame, len(self.data), self.starts, self.after, self.recovery_frames)


def write_bitstreams(stream: BinaryIO, bitstreams: Iterable[bytes], job_id: str) -> int:
    """Write a job's file, one bitstream at a time as they come; return the sum of their sizes in bytes."""
    return _write(stream, _MAGIC, ((data, _ENTRY, ()) for data in bitstreams), job_id)


def write_stream(stream: BinaryIO, packets: Iterable[CodedPacket], job_id: str) -> int:
    """Write the file of a job with an inter-frame codec, as `write_bitstreams` does."""
    return _write(stream, _STREAM, ((packet.data, _STREAM_ENTRY, _stream_fields(packet)) for packet in packets), job_id)


def _stream_fields(packet: CodedPacket) -> tuple[int, ...]:
    """Return a packet's index fields after offset, size and CRC."""
    recovery = _NO_RECOVERY if packet.recovery_frames is None else packet.recovery_frames
    return packet.frame, packet.after, packet.starts, recovery


def _write(
    stream: BinaryIO, magic: bytes, entries: Iterable[tuple[bytes, struct.Struct, tuple[int, ...]]], job_id: str
) -> int:
    """Write a file. entries: bytes, the format of their index entry, and its fields after offset, size and CRC."""
    digest = hashlib.blake2b(digest_size=DIGEST_BYTES)

    def put(data: bytes) -> None:
        stream.write(data)
        digest.update(data)

    put(magic + _owner(job_id))
    index = bytearray()
    offset, count = _START, 0
    for data, entry_format, details in entries:
        put(data)
        index += entry_format.pack(offset, len(data), zlib.crc32(data), *details)
        offset += len(data)
        count += 1
    put(bytes(index))
    head = struct.pack("<QQI16s", offset, count, zlib.crc32(index), digest.digest())
    stream.write(head + struct.pack("<I", zlib.crc32(head)))
    return offset - _START


class BitstreamFile:
    """The bitstreams of one coding job, one per frame, read on demand.

    `source` is the path of the file, or its content for workers that do not see the run folder. is_stream: whether it
    holds packets of an inter-frame codec. digest: of the whole content. Raises BitstreamDamage if the file is not whole
    or belongs to another job.
    """

    def __init__(self, source: Path | bytes, job_id: str) -> None:
        self._name = str(source) if isinstance(source, Path) else "bitstreams"
        self._data: bytes | mmap.mmap = _map_file(source) if isinstance(source, Path) else source
        self.is_stream = self._data[: len(_STREAM)] in (_STREAM, _EARLIER_STREAM)
        self._check_owner(job_id)
        self.digest, self._entries = self._read_index()
        self._places = {entry[3]: place for place, entry in enumerate(self._entries)} if self.is_stream else None
        if self._places is not None and self._places.keys() != set(range(len(self._entries))):
            raise BitstreamDamage(f"{self._name}: damaged (not one packet for each frame)")

    def __len__(self) -> int:
        return len(self._entries)

    @cached_property
    def packets(self) -> tuple[SentPacket, ...]:
        """The packets in sending order; without a stream, one per frame, each decodable by itself."""
        if self._places is None:
            return tuple(SentPacket(frame, entry[1], True, frame + 1) for frame, entry in enumerate(self._entries))
        return tuple(_sent_packet(*entry[1:2], *entry[3:]) for entry in self._entries)

    def size_bytes(self, frame: int) -> int:
        return int(self._entry(frame)[1])

    def read(self, frame: int) -> bytes:
        """Return the bitstream of a frame, checked against its CRC."""
        offset, size, crc, *_ = self._entry(frame)
        bitstream = bytes(self._data[offset : offset + size])
        if zlib.crc32(bitstream) != crc:
            raise BitstreamDamage(f"{self._name}: bitstream {frame} is damaged (CRC-32 differs)")
        return bitstream

    def _entry(self, frame: int) -> tuple[Any, ...]:
        return self._entries[frame if self._places is None else self._places[frame]]

    def _check_owner(self, job_id: str) -> None:
        magic, owner = self._data[: len(_MAGIC)], self._data[len(_MAGIC) : _START]
        if magic == _EARLIER:
            raise BitstreamDamage(f"{self._name}: written by an earlier version, without the id of its job")
        if magic not in (_MAGIC, _STREAM, _EARLIER_STREAM) or len(owner) != _ID_BYTES:
            raise BitstreamDamage(f"{self._name}: not a file of bitstreams, or truncated ({len(self._data)} bytes)")
        if owner != _owner(job_id):
            actual = owner.decode("ascii", "backslashreplace").rstrip()
            raise BitstreamDamage(f"{self._name}: contains the bitstreams of job {actual}, not of {job_id}")

    def _read_index(self) -> tuple[bytes, list[tuple[Any, ...]]]:
        """Return the digest, and each index entry: offset, size, CRC, and for packets what `_sent_packet` takes."""
        data, length = self._data, len(self._data)
        if length < _START + _FOOTER.size:
            raise BitstreamDamage(f"{self._name}: not a file of bitstreams, or truncated ({length} bytes)")
        entry_format = {_STREAM: _STREAM_ENTRY, _EARLIER_STREAM: _EARLIER_STREAM_ENTRY}.get(
            bytes(data[: len(_MAGIC)]), _ENTRY
        )
        footer = data[length - _FOOTER.size :]
        offset, count, index_crc, digest, footer_crc = _FOOTER.unpack(footer)
        if zlib.crc32(footer[:-4]) != footer_crc or offset + count * entry_format.size + _FOOTER.size != length:
            raise BitstreamDamage(f"{self._name}: truncated or damaged (footer)")
        index = data[offset : length - _FOOTER.size]
        if zlib.crc32(index) != index_crc:
            raise BitstreamDamage(f"{self._name}: damaged (index)")
        return digest, list(entry_format.iter_unpack(index))


def _sent_packet(size: int, frame: int, after: int, starts: bool, recovery: int = _NO_RECOVERY) -> SentPacket:
    return SentPacket(frame, size, starts, after, None if recovery == _NO_RECOVERY else recovery)


def _owner(job_id: str) -> bytes:
    return job_id.encode("ascii").ljust(_ID_BYTES)


def _map_file(path: Path) -> bytes | mmap.mmap:
    try:
        with open_plain(path) as stream:
            if os.fstat(stream.fileno()).st_size == 0:
                return b""
            return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except FileNotFoundError:
        raise BitstreamDamage(f"{path}: missing") from None
    except OSError as error:
        raise BitstreamDamage(f"{path}: {error.strerror}") from error


class EncoderNotes:
    """Notes beside bitstream files of which code of the codec wrote them, by coding job id."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._known: dict[str, str] = {}

    def write(self, job_id: str, code: str) -> None:
        """Note the codec's code, as `code_of` returns it, of bitstreams that were just written."""
        body = {"job": job_id, "code": code}
        write_file(self._path(job_id), json.dumps({"checksum": digest(body), **body}).encode() + b"\n")
        self._known[job_id] = code

    def read(self, job_id: str) -> str:
        """Return the code that wrote a job's bitstreams; empty if it is unknown or the note is damaged."""
        if job_id not in self._known:
            self._known[job_id] = self._read(job_id)
        return self._known[job_id]

    def damaged(self, job_id: str) -> bool:
        """Whether a job has a note that cannot be read."""
        return not self.read(job_id) and self._path(job_id).exists()

    def _read(self, job_id: str) -> str:
        try:
            document = json_from_bytes(read_plain(self._path(job_id)))
            body = {"job": job_id, "code": document["code"]}
            return clean_line(document["code"]) if digest(body) == document["checksum"] else ""
        except (OSError, ValueError, KeyError, TypeError):
            return ""

    def _path(self, job_id: str) -> Path:
        return self._folder / f"{job_id}.code"
