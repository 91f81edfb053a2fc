"""The folder with the files of a pool's workers: locked while the pool lives, removed by the next pool after a kill."""

from __future__ import annotations

import fcntl
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Final, TextIO

from codecbench.plugins.executors.isolation import WorkerFiles

_PREFIX: Final = "codecbench-workers-"
_ROOM_BYTES: Final = 1 << 16


class WorkerFolder:
    """A new, locked folder in `parent`, by default the system's for temporary files. Raises OSError on a full disk.

    Folders that pools left whose process was killed are removed first: nobody holds their locks.
    """

    def __init__(self, parent: str | None = None) -> None:
        parent = parent or tempfile.gettempdir()
        _sweep(parent)
        self._path, self._lock = _locked_folder(parent)

    def files(self, number: int) -> WorkerFiles:
        """Where the worker of this number keeps its files."""
        return WorkerFiles(*(self._path / f"{number}.{ending}" for ending in ("json", "out", "tmp")))

    def remove(self) -> None:
        """Remove the folder with all that is in it, and let go of its lock."""
        shutil.rmtree(self._path, ignore_errors=True)
        self._lock.close()


def _locked_folder(parent: str) -> tuple[Path, TextIO]:
    """A new folder, and the file whose lock says that its pool lives."""
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent))
        with suppress(FileNotFoundError):  # another pool swept it before it was locked
            lock = open(folder / "lock", "w", encoding="ascii")  # noqa: SIM115 - held as long as the pool
            _require_room(lock)
            if _locked(lock) and (folder / "lock").exists():
                return folder, lock
            lock.close()


def _require_room(file: TextIO) -> None:
    """Raise OSError on a full disk, where every worker would end before it began."""
    try:
        file.write("\0" * _ROOM_BYTES)
        file.flush()
        file.truncate(0)
    except OSError as error:
        file.close()
        shutil.rmtree(Path(file.name).parent, ignore_errors=True)
        error.filename = str(Path(file.name).parent.parent)
        raise


def _sweep(parent: str) -> None:
    for path in Path(parent).glob(f"{_PREFIX}*/lock"):
        with suppress(OSError), open(path, "r+", encoding="ascii") as lock:
            if _locked(lock):
                shutil.rmtree(path.parent, ignore_errors=True)


def _locked(lock: TextIO) -> bool:
    with suppress(BlockingIOError):
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    return False
