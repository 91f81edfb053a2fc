"""One file for all bitstreams of a coding job, with a checksum a frame and one over the whole.

    magic | job id | bitstream 0 | bitstream 1 | ... | index: offset, size, CRC-32 of each | footer

The job id, which names sequence and codec setting, says whose bitstreams these are, so that two files that changed
places are noticed. The footer says where the index is and carries CRCs of the index and of itself, so that a torn or
damaged file is noticed when it is opened, and a damaged bitstream when it is read. A BLAKE2b digest of all before
it is in the footer too, so that copies can be compared by their last bytes. Nothing here knows what a codec is.
"""

from __future__ import annotations

import hashlib
import mmap
import os
import struct
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.identity import DIGEST_BYTES
from codecbench.core.engine.storage.plain_file import open_plain

_MAGIC = b"CBBITS\x00\x02"
_EARLIER = b"CBBITS\x00\x01"
_ID_BYTES = 2 * DIGEST_BYTES
_ENTRY = struct.Struct("<QQI")
_FOOTER = struct.Struct("<QQI16sI")
_START = len(_MAGIC) + _ID_BYTES


class BitstreamDamage(StoreError):
    """A file of bitstreams is truncated or damaged; the engine encodes the sequence again."""


def write_bitstreams(stream: BinaryIO, bitstreams: Iterable[bytes], job_id: str) -> int:
    """Write a whole file of a job, one bitstream at a time as they come, and return the sum of their sizes in bytes."""
    whole = hashlib.blake2b(digest_size=DIGEST_BYTES)

    def put(data: bytes) -> None:
        stream.write(data)
        whole.update(data)

    put(_MAGIC + _owner(job_id))
    index = bytearray()
    offset, count = _START, 0
    for bitstream in bitstreams:
        put(bitstream)
        index += _ENTRY.pack(offset, len(bitstream), zlib.crc32(bitstream))
        offset += len(bitstream)
        count += 1
    put(bytes(index))
    head = struct.pack("<QQI16s", offset, count, zlib.crc32(index), whole.digest())
    stream.write(head + struct.pack("<I", zlib.crc32(head)))
    return offset - _START


class BitstreamFile:
    """Bitstreams of one coding job, read as they are asked for.

    `source` is the path of the file or its content, for workers that do not see the run folder. Raises
    BitstreamDamage for a file that is not whole, or is that of another job.
    """

    def __init__(self, source: Path | bytes, job_id: str) -> None:
        self._name = str(source) if isinstance(source, Path) else "bitstreams"
        self._data: bytes | mmap.mmap = _mapped(source) if isinstance(source, Path) else source
        self._check_owner(job_id)
        self._entries = self._read_index()

    def __len__(self) -> int:
        return len(self._entries)

    def size_bytes(self, index: int) -> int:
        return self._entries[index][1]

    def read(self, index: int) -> bytes:
        """Bitstream `index`, checked against its CRC."""
        offset, size, crc = self._entries[index]
        bitstream = bytes(self._data[offset : offset + size])
        if zlib.crc32(bitstream) != crc:
            raise BitstreamDamage(f"{self._name}: bitstream {index} is damaged (CRC-32 differs)")
        return bitstream

    def _check_owner(self, job_id: str) -> None:
        magic, owner = self._data[: len(_MAGIC)], self._data[len(_MAGIC) : _START]
        if magic == _EARLIER:
            raise BitstreamDamage(
                f"{self._name}: an earlier version wrote it, without saying whose bitstreams they are"
            )
        if magic != _MAGIC or len(owner) != _ID_BYTES:
            raise BitstreamDamage(f"{self._name}: not a file of bitstreams, or truncated ({len(self._data)} bytes)")
        if owner != _owner(job_id):
            found = owner.decode("ascii", "backslashreplace").rstrip()
            raise BitstreamDamage(f"{self._name}: holds the bitstreams of job {found}, not of {job_id}")

    def _read_index(self) -> list[tuple[int, int, int]]:
        data, length = self._data, len(self._data)
        if length < _START + _FOOTER.size:
            raise BitstreamDamage(f"{self._name}: not a file of bitstreams, or truncated ({length} bytes)")
        footer = data[length - _FOOTER.size :]
        offset, count, index_crc, _, footer_crc = _FOOTER.unpack(footer)
        if zlib.crc32(footer[:-4]) != footer_crc or offset + count * _ENTRY.size + _FOOTER.size != length:
            raise BitstreamDamage(f"{self._name}: truncated or damaged (footer)")
        index = data[offset : length - _FOOTER.size]
        if zlib.crc32(index) != index_crc:
            raise BitstreamDamage(f"{self._name}: damaged (index)")
        return list(_ENTRY.iter_unpack(index))


def _owner(job_id: str) -> bytes:
    return job_id.encode("ascii").ljust(_ID_BYTES)


def _mapped(path: Path) -> bytes | mmap.mmap:
    try:
        with open_plain(path) as stream:
            if os.fstat(stream.fileno()).st_size == 0:
                return b""
            return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except FileNotFoundError:
        raise BitstreamDamage(f"{path}: missing") from None
    except OSError as error:
        raise BitstreamDamage(f"{path}: {error.strerror}") from error
