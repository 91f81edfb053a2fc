"""Locked temporary folders, which outlive a killed process only until the next one; and processes to leave running."""

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
"""Process ids that a task leaves running for the next one in this worker; all others it left may be killed."""


class HeldFolder:
    """A new, locked folder of temporary files; as a context manager it removes itself."""

    def __init__(self, prefix: str, parent: str | None = None) -> None:
        """Create the folder in `parent`, by default the system's temporary folder. Raises OSError on a full disk.

        First removes folders whose name begins with `prefix` and whose lock is free: their processes were killed.
        """
        parent = parent or tempfile.gettempdir()
        _sweep(prefix, parent)
        self.path, self._lock = _create_locked(prefix, parent)

    def remove(self) -> None:
        """Remove the folder with its files, and release its lock."""
        _remove(self.path)
        self._lock.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.remove()


def _create_locked(prefix: str, parent: str) -> tuple[Path, TextIO]:
    """Create a folder; return it and the file whose lock marks it as in use."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
        with suppress(FileNotFoundError):  # another process swept it before it was locked
            lock = open(folder / "lock", "w", encoding="ascii")  # noqa: SIM115 - held as long as the folder
            if _lock_now(lock) and (folder / "lock").exists():
                return folder, lock
            lock.close()


def _sweep(prefix: str, parent: str) -> None:
    for path in Path(parent).glob(f"{prefix}*/lock"):
        with suppress(OSError), open(path, "r+", encoding="ascii", opener=open_plain) as lock:
            if _lock_now(lock):
                _remove(path.parent)


def _remove(folder: Path) -> None:
    try:
        shutil.rmtree(folder, ignore_errors=True)
    except RecursionError:  # a plugin nested folders too deeply
        subprocess.run(["rm", "-rf", str(folder)], check=False)


def open_plain(path: str, flags: int) -> int:
    """Open a file in a plugin's folder; follow no link, which could lead to foreign files, and wait for no pipe."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK)


def _lock_now(lock: TextIO) -> bool:
    """Lock the file without waiting; return whether that succeeded."""
    with suppress(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False
