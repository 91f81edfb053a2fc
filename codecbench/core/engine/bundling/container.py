"""The file format of a bundle: a zip file with a manifest, checked completely before a file is written.

A stranger may have made it. A zip file's directory gives names, sizes and kinds of all files, so they can be refused
before a byte is unpacked; a tar file gives them only on the way.
"""

from __future__ import annotations

import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, BinaryIO, Final, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.identity import json_from_bytes
from codecbench.core.engine.text import clean_line

FORMAT: Final = 1
MANIFEST: Final = "manifest.json"

MOST_FILES: Final = 400_000
"""A plan has at most 100,000 cells, and a cell has a record, its samples and one or two more files."""
LARGEST_FILE: Final = 512_000_000
"""Maximum bytes of a file that is read whole: records, samples, artifacts, the plan, the manifest."""
LARGEST_BITSTREAMS: Final = 32_000_000_000
"""Maximum bytes of the bitstreams of one sequence, which are read frame by frame."""

_LONGEST_NAME: Final = 200
_ID: Final = "[0-9a-f]{32}"
_NAME_PATTERN: Final = re.compile(
    rf"matrix\.yaml|plan\.json|environment/[0-9a-f]{{8,64}}\.json|coded/{_ID}\.(bits|code)"
    r"|records/([0-9a-f]{2})/\2[0-9a-f]{30}/[^./\\][^/\\]*"
)
"""The files of a run folder that a bundle may contain; a name of another form is refused, not corrected."""


def largest_bytes(name: str) -> int:
    """Return the maximum size of a file with this name."""
    return LARGEST_BITSTREAMS if name.endswith(".bits") and name.startswith("coded/") else LARGEST_FILE


def _check_name(name: str) -> str:
    if not (_NAME_PATTERN.fullmatch(name) and name.isprintable() and len(name.encode()) <= _LONGEST_NAME):
        raise ValueError(f"{clean_line(name)!r} is not the name of a file of a run")
    return name


FileName = Annotated[str, AfterValidator(_check_name)]
"""Path inside a run folder, with `/`, of a file that a bundle may contain. Raises ValueError for any other."""

_Line = Annotated[str, AfterValidator(clean_line)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, strict=True, extra="ignore")


class FileFacts(_Part):
    """Size in bytes and SHA-256 of a file."""

    size: int = Field(ge=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class Manifest(_Part):
    """What a bundle contains."""

    format: Literal[1] = FORMAT
    codecbench: _Line
    """The version that wrote it."""
    name: _Line
    cells: int = Field(ge=0)
    """Number of cells in the plan."""
    statuses: dict[_Line, int]
    """Number of cells by status; cells without a record are not counted."""
    bitstreams: bool
    """Whether the codecs' output is included."""
    files: dict[FileName, FileFacts]


_FILE_NAME: Final = TypeAdapter(FileName)
_METHODS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED: Final = 0x1

_MOST_RATIO: Final = 100
"""Maximum ratio of unpacked to packed bytes; bundles of codecbench stay below 10."""
_SLACK: Final = 64_000_000
"""Bytes that may be unpacked whatever the ratio: a small run compresses well."""

_END: Final = struct.Struct("<4s4H2LH")
_LOCATOR: Final = struct.Struct("<4sLQL")
_END64: Final = struct.Struct("<4sQ2H2L4Q")
_LARGEST_DIRECTORY: Final = 120_000_000
_ENTRY_MAGIC: Final = b"PK\x01\x02"
_DAMAGE: Final = (
    zipfile.BadZipFile, zlib.error, EOFError, ValueError, KeyError, RuntimeError, struct.error, OverflowError,
)  # fmt: skip
"""What reading a damaged zip file raises; RuntimeError also for an unsupported compression method."""


@dataclass(frozen=True)
class OpenBundle:
    """A bundle whose names, sizes and kinds of files are valid; the files' content is not checked yet."""

    manifest: Manifest
    archive: zipfile.ZipFile


@contextmanager
def open_bundle(path: Path) -> Iterator[OpenBundle]:
    """Open a bundle. Raises StoreError if it is none, is refused, or proves to be damaged in the block."""
    if not path.is_file():
        raise StoreError(f"{path} is not a bundle: there is no such file")
    try:
        with open(path, "rb") as stream:
            _require_small_directory(stream, path.stat().st_size)
            with zipfile.ZipFile(stream) as archive:
                members = _check_members(archive.infolist(), path.stat().st_size)
                yield OpenBundle(_manifest(archive, members), archive)
    except _DAMAGE as error:
        reason = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error) or type(error).__name__
        message = f"{path} is refused: {clean_line(reason.removeprefix('Value error, '))}"
        raise StoreError(f"{message}; nothing of it was unpacked") from error


def _require_small_directory(stream: BinaryIO, size: int) -> None:
    """Raise ValueError if the list of files is too large to be read."""
    stream.seek(max(0, size - _END.size))
    end = stream.read(_END.size)
    if len(end) < _END.size or not end.startswith(b"PK\x05\x06") or _END.unpack(end)[-1]:
        raise ValueError("it does not end like a bundle: truncated, or not a bundle")
    length, start = _END.unpack(end)[5:7]
    locator_at = size - _END.size - _LOCATOR.size
    if locator_at >= 0:
        stream.seek(locator_at)
        magic, _, end64_at, _ = _LOCATOR.unpack(stream.read(_LOCATOR.size))
        if magic == b"PK\x06\x07":
            stream.seek(min(end64_at, size))
            length, start = _END64.unpack(stream.read(_END64.size))[8:10]
    if length > min(size, _LARGEST_DIRECTORY):
        raise ValueError(f"its list of files has {length:,} bytes")
    stream.seek(start)
    count = stream.read(length).count(_ENTRY_MAGIC)
    if count > MOST_FILES:
        raise ValueError(f"it has {count:,} files; at most {MOST_FILES:,} are allowed")
    stream.seek(0)


def _check_members(infos: list[zipfile.ZipInfo], packed_bytes: int) -> dict[str, zipfile.ZipInfo]:
    """Return the members by name. Raises ValueError for one that is not a plain file of a run, or is too large."""
    members: dict[str, zipfile.ZipInfo] = {}
    for info in infos:
        name = info.orig_filename
        if name != MANIFEST:
            _FILE_NAME.validate_python(name)
        if name in members:
            raise ValueError(f"it has two files {name!r}")
        if stat.S_IFMT(info.external_attr >> 16) not in (0, stat.S_IFREG) or info.is_dir():
            raise ValueError(f"{name!r} is a link, a folder or a device")
        if info.flag_bits & _ENCRYPTED or info.compress_type not in _METHODS:
            raise ValueError(f"{name!r} is encrypted or packed by another method than deflate")
        if info.file_size > largest_bytes(name):
            raise ValueError(f"{name!r} has {info.file_size:,} bytes; at most {largest_bytes(name):,} are allowed")
        members[name] = info
    _require_apart(infos)
    unpacked, limit = sum(info.file_size for info in infos), _SLACK + _MOST_RATIO * packed_bytes
    if unpacked > limit:
        raise ValueError(f"its {packed_bytes:,} bytes would unpack to {unpacked:,}; at most {limit:,} are allowed")
    return members


def _require_apart(infos: list[zipfile.ZipInfo]) -> None:
    """Raise ValueError if two members share bytes, as in a zip bomb."""
    end = 0
    for info in sorted(infos, key=lambda info: info.header_offset):
        if info.header_offset < end:
            raise ValueError(f"{info.filename!r} overlaps another file")
        end = info.header_offset + info.compress_size


def _manifest(archive: zipfile.ZipFile, members: dict[str, zipfile.ZipInfo]) -> Manifest:
    """Return the manifest. Raises ValueError if it does not match the members."""
    if MANIFEST not in members:
        raise ValueError(f"it has no {MANIFEST}")
    with archive.open(MANIFEST) as stream:
        manifest = Manifest.model_validate(json_from_bytes(stream.read(LARGEST_FILE)))
    listed = {name: facts.size for name, facts in manifest.files.items()}
    actual = {name: info.file_size for name, info in members.items() if name != MANIFEST}
    if listed != actual:
        wrong = sorted(name for name in listed.keys() | actual.keys() if listed.get(name) != actual.get(name))
        raise ValueError(f"{wrong[0]!r} does not match {MANIFEST}, and {len(wrong) - 1} more")
    for name in ("plan.json", "matrix.yaml"):
        if name not in listed:
            raise ValueError(f"it has no {name}")
    return manifest
