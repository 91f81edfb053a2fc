"""Write files and folders that are complete or absent: each is written beside its place, then renamed into it.

With `durable`, the data and all folders that lead to it are on disk when the function returns, and survive a power cut;
that takes milliseconds. Without it, a power cut may lose or damage them until `sync_file_system` was called.
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
    """Write `content` to `path`, replacing what was there in one step.

    Raises OSError (disk full, read-only) and then leaves `path` as it was.
    """
    with open_whole(path, durable=durable) as stream:
        stream.write(content)


@contextmanager
def open_whole(path: Path, *, durable: bool = False) -> Iterator[BinaryIO]:
    """Open a file for writing that appears at `path` only if the block ends without an error.

    Devices and pipes are written to directly.
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
    """Make a folder and its missing parents. Raises OSError."""
    missing = [folder for folder in (path, *path.parents) if not folder.exists()] if durable else []
    path.mkdir(parents=True, exist_ok=True)
    for folder in missing:
        _sync_folder(folder.parent)


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Set the file name of OSErrors raised in the block to `path` if they name no file or a temporary one."""
    try:
        yield
    except OSError as error:
        parts = () if error.filename is None else Path(os.fsdecode(error.filename)).parts
        if not parts or any(part.startswith((".new-", ".old-")) for part in parts):
            error.filename, error.filename2 = str(path), None
        raise


def write_folder(path: Path, contents: Mapping[str, bytes], *, durable: bool = False) -> None:
    """Write a folder of files to `path`, replacing what was there.

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
    """Yield a folder to fill; it appears at `path`, which must not exist, only if the block ends without an error.

    The block must make its own files durable. Raises OSError.
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
    """Delete what interrupted writers left in `folder`. Only the one process that may write there may call this."""
    for pattern in (".new-*", ".old-*"):
        for leftover in folder.glob(pattern):
            if leftover.is_dir():
                shutil.rmtree(leftover, ignore_errors=True)
            else:
                leftover.unlink(missing_ok=True)


def _write_plain(path: Path, content: bytes, durable: bool) -> None:
    with open(path, "wb") as stream:
        stream.write(content)
        stream.flush()
        if durable:
            os.fsync(stream.fileno())


def sync_file_system(folder: Path) -> None:
    """Wait until everything written on the file system of `folder` is on disk.

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
