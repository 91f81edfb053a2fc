"""Files and folders that are complete or absent: written beside their place, then renamed into it.

What is `durable` is on the disk when the function returns, with every folder that leads to it, and outlasts a power
cut; it takes milliseconds. What is not may be lost or damaged by one until `sync_file_system` was called.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, Final

_libc: Final = ctypes.CDLL(None, use_errno=True)


def write_file(path: Path, content: bytes, *, durable: bool = False) -> None:
    """Put `content` at `path`, replacing what was there in one step.

    Raises OSError (disk full, read-only) and then leaves `path` as it was.
    """
    with open_whole(path, durable=durable) as stream:
        stream.write(content)


@contextmanager
def open_whole(path: Path, *, durable: bool = False) -> Iterator[BinaryIO]:
    """A file to write that appears at `path` when the block ends well, and not at all when it does not.

    What is no file (a device, a pipe) is written to as it is.
    """
    if path.exists() and not path.is_file():
        with open(path, "wb") as stream:
            yield stream
        return
    with _naming(path):
        make_folder(path.parent, durable=durable)
        handle, name = tempfile.mkstemp(prefix=".new-", dir=path.parent)
    try:
        with _naming(path), os.fdopen(handle, "wb") as stream:
            yield stream
            stream.flush()
            if durable:
                os.fsync(stream.fileno())
        with _naming(path):
            os.chmod(name, 0o644)
            os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
    if durable:
        _sync_folder(path.parent)


def make_folder(path: Path, *, durable: bool = False) -> None:
    """Make a folder and those above it, where they are missing. Raises OSError."""
    missing = [folder for folder in (path, *path.parents) if not folder.exists()] if durable else []
    path.mkdir(parents=True, exist_ok=True)
    for folder in missing:
        _sync_folder(folder.parent)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """An error of the system meanwhile names `path`, where it names nothing or what is only there meanwhile."""
    try:
        yield
    except OSError as error:
        parts = () if error.filename is None else Path(os.fsdecode(error.filename)).parts
        if not parts or any(part.startswith((".new-", ".old-")) for part in parts):
            error.filename, error.filename2 = str(path), None
        raise


def write_folder(path: Path, contents: Mapping[str, bytes], *, durable: bool = False) -> None:
    """Put a folder of files at `path`, replacing what was there.

    A reader sees the old folder, none or the new one, never a mixture. Raises OSError like `write_file`.
    """
    with open_whole_folder(path, durable=durable) as new:
        for name, content in contents.items():
            _write_plain(new / name, content, durable)
        if durable:
            _sync_folder(new)
        if path.exists():
            remove_folder(path)


@contextmanager
def open_whole_folder(path: Path, *, durable: bool = False) -> Iterator[Path]:
    """A folder to fill that appears at `path`, which is not there by then, when the block ends well; or not at all.

    What the block puts into it is made durable by the block. Raises OSError.
    """
    with _naming(path):
        make_folder(path.parent, durable=durable)
        new = Path(tempfile.mkdtemp(prefix=".new-", dir=path.parent))
        try:
            new.chmod(0o755)
            yield new
            os.rename(new, path)
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise
    if durable:
        _sync_folder(path.parent)


def remove_folder(path: Path) -> None:
    """Remove a folder so that no reader ever sees half of it."""
    old = Path(tempfile.mkdtemp(prefix=".old-", dir=path.parent))
    os.rename(path, old / "removed")
    shutil.rmtree(old, ignore_errors=True)


def sweep(folder: Path) -> None:
    """Delete what interrupted writers left in `folder`. Only for the one process that may write there."""
    for pattern in (".new-*", ".old-*"):
        for rest in folder.glob(pattern):
            if rest.is_dir():
                shutil.rmtree(rest, ignore_errors=True)
            else:
                rest.unlink(missing_ok=True)


def _write_plain(path: Path, content: bytes, durable: bool) -> None:
    with open(path, "wb") as stream:
        stream.write(content)
        stream.flush()
        if durable:
            os.fsync(stream.fileno())


def sync_file_system(folder: Path) -> None:
    """Wait until the disk has everything that was written on the file system of `folder`.

    For many small files this is faster by orders of magnitude than waiting for each. Raises OSError.
    """
    with _folder_descriptor(folder) as handle:
        if _libc.syncfs(handle) != 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), str(folder))


def _sync_folder(folder: Path) -> None:
    with _folder_descriptor(folder) as handle:
        os.fsync(handle)


@contextmanager
def _folder_descriptor(folder: Path) -> Iterator[int]:
    handle = os.open(folder, os.O_RDONLY)
    try:
        yield handle
    finally:
        os.close(handle)
