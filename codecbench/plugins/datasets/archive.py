"""Unpacking archives from elsewhere: plain files below one folder, and nothing else."""

from __future__ import annotations

import shutil
import tarfile
import tempfile
import zipfile
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path, PurePosixPath
from typing import IO

from codecbench.core.contracts.errors import DatasetError


def unpack(archive: Path, folder: Path, inside: str = "", leave_out: tuple[str, ...] = ()) -> None:
    """Put the files of a .zip or tar archive into `folder`, which appears whole or not at all.

    inside: the folder in the archive whose content is wanted. leave_out: patterns of names that are not
    needed. Raises DatasetError for damage, and for members that are links, devices or outside the folder.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    new = Path(tempfile.mkdtemp(prefix=".new-", dir=folder.parent))
    try:
        count = 0
        for name, stream in _members(archive):
            path = _checked(name, archive)
            if inside and path.parts[: len(PurePosixPath(inside).parts)] != PurePosixPath(inside).parts:
                continue
            if any(fnmatch(name, pattern) for pattern in leave_out):
                continue
            target = new / path.relative_to(inside)
            target.parent.mkdir(parents=True, exist_ok=True)
            with open(target, "wb") as output:
                shutil.copyfileobj(stream, output, 1 << 20)
            count += 1
        if not count:
            raise DatasetError(f"{archive}: holds no files" + (f" in {inside}/" if inside else ""))
        new.chmod(0o755)
        new.rename(folder)
    except (tarfile.TarError, zipfile.BadZipFile, EOFError, ValueError, NotImplementedError) as error:
        # NotImplementedError is zipfile's word for a method of compression that it does not know
        raise DatasetError(f"{archive}: is damaged or no archive: {error}; fetch it again") from error
    except OSError as error:
        raise DatasetError(f"{archive}: cannot be unpacked into {folder}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(new, ignore_errors=True)


def _members(archive: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Name and content of every file."""
    if archive.suffix == ".zip":
        with zipfile.ZipFile(archive) as packed:
            for info in packed.infolist():
                if not info.is_dir():
                    if (info.external_attr >> 28) == 0o12:
                        raise DatasetError(f"{archive}: {info.filename!r} is a link; nothing was unpacked")
                    with packed.open(info) as stream:
                        yield info.filename, stream
        return
    with tarfile.open(archive, "r:*") as packed_tar:
        for member in packed_tar:
            if member.isdir():
                continue
            if not member.isreg():
                raise DatasetError(f"{archive}: {member.name!r} is a link or a device; nothing was unpacked")
            content = packed_tar.extractfile(member)
            if content is not None:
                yield member.name, content


def _checked(name: str, archive: Path) -> PurePosixPath:
    path = PurePosixPath(name)
    if not path.parts:
        raise DatasetError(f"{archive}: a file is called {name!r}, which names none; nothing was unpacked")
    if path.is_absolute() or ".." in path.parts or "\\" in name or ":" in path.parts[0]:
        raise DatasetError(f"{archive}: {name!r} would lie outside its folder; nothing was unpacked")
    return path
