"""An append-only file that lists all records, so that listing 100,000 of them takes a second.

The records are the truth and the index is a copy: a torn, damaged or missing line is rebuilt from its record, and a
line without a record is dropped. Each line has a CRC of itself and the digests of the record and its files, so that a
record can be checked without parsing it.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Final

from pydantic import Strict, TypeAdapter

from codecbench.core.engine.identity import content_digest, json_from_bytes
from codecbench.core.engine.plugins.fingerprint import code_digest
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.storage.plain_file import read_plain
from codecbench.core.engine.storage.record import RECORD_FILE, FileName, Record, settings_digest
from codecbench.core.engine.text import clean_line

_SEPARATOR: Final = " "
_LINE: Final = TypeAdapter(Annotated[tuple[str, str, str, float, dict[FileName, str], str, str], Strict(False)])
"""Fields of a line; if a line differs, as earlier versions wrote it, the record is read instead."""


@dataclass(frozen=True)
class IndexEntry:
    """What the index stores about a record."""

    cell_id: str
    status: str
    reason: str
    duration_s: float
    digests: dict[str, str]
    """Digests of `record.json` and of each file beside it."""
    settings: str
    """Digest of the parameters of all its plugins."""
    code: str
    """Digest of the fingerprints of their code; empty if the record does not have them."""


def entry_from_record(record: Record, content: bytes) -> IndexEntry:
    """Return the entry of a record whose file has this content."""
    digests = {RECORD_FILE: content_digest(content)}
    digests |= {name: facts["digest"] for name, facts in record.files.items()}
    settings = settings_digest(record.cell)
    code = code_digest(record.code)
    return IndexEntry(record.cell_id, record.status, record.reason, record.duration_s, digests, settings, code)


class RecordIndex:
    """The index file of a run folder. Entries are appended as records are written."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def read(self) -> dict[str, IndexEntry]:
        """Return the latest entry of each cell; damaged lines are skipped."""
        try:
            content = read_plain(self._path)
        except OSError:
            return {}
        entries: dict[str, IndexEntry] = {}
        for line in content.split(b"\n"):
            entry = _entry_from_line(line)
            if entry is not None:
                entries[entry.cell_id] = entry
        return entries

    def append(self, entry: IndexEntry) -> None:
        """Append one entry; first terminate a torn last line left by a crash."""
        line = _line_from_entry(entry) + b"\n"
        with open(self._path, "ab+", buffering=0) as stream:
            end = stream.tell()
            if end:
                stream.seek(end - 1)
                if stream.read(1) != b"\n":
                    line = b"\n" + line
            stream.write(line)

    def rewrite(self, entries: Iterable[IndexEntry]) -> None:
        """Replace the whole file."""
        write_file(self._path, b"".join(_line_from_entry(entry) + b"\n" for entry in entries))


def _line_from_entry(entry: IndexEntry) -> bytes:
    head = [entry.cell_id, entry.status, entry.reason, round(entry.duration_s, 6)]
    fields = [*head, entry.digests, entry.settings, entry.code]
    text = json.dumps(fields, separators=(",", ":"), ensure_ascii=True).encode()
    return f"{zlib.crc32(text):08x}{_SEPARATOR}".encode() + text


def _entry_from_line(line: bytes) -> IndexEntry | None:
    crc, _, text = line.partition(_SEPARATOR.encode())
    if len(crc) != 8 or crc != b"%08x" % zlib.crc32(text):
        return None
    try:
        entry = IndexEntry(*_LINE.validate_python(json_from_bytes(text)))
    except ValueError:
        return None
    entry = replace(entry, status=clean_line(entry.status), reason=clean_line(entry.reason))
    return entry if RECORD_FILE in entry.digests else None
