"""What processes leave: folders of temporary files that are locked while somebody uses them, so that after a kill the
next of their kind removes them; and processes that stay."""

from __future__ import annotations

import fcntl
import os
import shutil
import subprocess
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final, Self, TextIO

left_running: Final[set[int]] = set()
"""Processes of this worker that a task leaves for the next one; any other that it left may be killed."""


class HeldFolder:
    """A new, locked folder in `parent`, by default the system's for temporary files. Raises OSError on a full disk.

    prefix: how the names of its kind begin. Those that processes left which were killed are removed first: nobody
    holds their locks. A context manager, which removes it.
    """

    def __init__(self, prefix: str, parent: str | None = None) -> None:
        parent = parent or tempfile.gettempdir()
        _sweep(prefix, parent)
        self.path, self._lock = _locked_folder(prefix, parent)

    def remove(self) -> None:
        """Remove the folder with all that is in it, and let go of its lock."""
        _remove(self.path)
        self._lock.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()


def _locked_folder(prefix: str, parent: str) -> tuple[Path, TextIO]:
    """A new folder, and the file whose lock says that it is in use."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        with suppress(FileNotFoundError):  # another process swept it before it was locked
            lock = open(folder / "lock", "w", encoding="ascii")  # noqa: SIM115 - held as long as the folder
            if _locked(lock) and (folder / "lock").exists():
                return folder, lock
            lock.close()


def _sweep(prefix: str, parent: str) -> None:
    for path in Path(parent).glob(f"{prefix}*/lock"):
        with suppress(OSError), open(path, "r+", encoding="ascii", opener=open_plain) as lock:
            if _locked(lock):
                _remove(path.parent)


def _remove(folder: Path) -> None:
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except RecursionError:  # a plugin made folders in folders
        subprocess.run(["rm", "-rf", str(folder)], check=False)


def open_plain(path: str, flags: int) -> int:
    """Open a file in a plugin's folder, which may be a link to what it cannot read, or a pipe that nobody writes to."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK)


def _locked(lock: TextIO) -> bool:
    with suppress(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False
