"""Read from a folder that may come from elsewhere: plain files only, and no links out of it."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from codecbench.core.contracts.errors import StoreError


def open_plain(path: str | Path) -> BinaryIO:
    """Open a plain file for reading. Raises OSError as `open` does, and for links, folders, pipes and devices."""
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError as error:
        if error.errno == errno.ELOOP:
            raise OSError(errno.ELOOP, "it is a link", str(path)) from None
        raise
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is not a plain file", str(path))
    return os.fdopen(handle, "rb", buffering=0)


def read_plain(path: str | Path) -> bytes:
    """Return the content of a plain file. Raises OSError like `open_plain`."""
    with open_plain(path) as stream:
        return stream.read()


def refuse_links(folder: Path, depth: int, root: Path | None = None) -> None:
    """Raise StoreError if a link below `folder`, down to `depth` levels, leads out of `root`.

    root: by default, the folder itself.
    """
    root = root or folder.resolve()
    try:
        entries = list(os.scandir(folder))
    except (FileNotFoundError, NotADirectoryError):
        return
    for entry in entries:
        if entry.is_symlink() and not Path(entry.path).resolve().is_relative_to(root):
            target = os.readlink(entry.path)
            message = f"{entry.path} is a link to {target}, outside the run folder; such links are not followed"
            raise StoreError(f"{message}: replace it with a file or folder, or remove it")
        if depth > 1 and entry.is_dir(follow_symlinks=False):
            refuse_links(Path(entry.path), depth - 1, root)
