"""The folder with the files of a pool's workers: held while the pool lives, removed by the next pool after a kill."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from codecbench.core.contracts.held_folder import HeldFolder
from codecbench.plugins.executors.isolation import WorkerFiles

_PREFIX: Final = "codecbench-workers-"
_ROOM_BYTES: Final = 1 << 16


class WorkerFolder:
    """A new folder in `parent`, by default the system's for temporary files. Raises OSError on a full disk.

    Folders that pools left whose process was killed are removed first.
    """

    def __init__(self, parent: str | None = None) -> None:
        self._folder = HeldFolder(_PREFIX, parent)
        try:
            _require_room(self._folder.path / "room")
        except OSError as error:
            self.remove()
            error.filename = str(self._folder.path.parent)
            raise

    def files(self, number: int) -> WorkerFiles:
        """Where the worker of this number keeps its files."""
        return WorkerFiles(*(self._folder.path / f"{number}.{ending}" for ending in ("json", "out", "tmp")))

    def remove(self) -> None:
        """Remove the folder with all that is in it."""
        self._folder.remove()


def _require_room(path: Path) -> None:
    """Raise OSError on a full disk, where every worker would end before it began."""
    with open(path, "w", encoding="ascii") as file:
        file.write("\0" * _ROOM_BYTES)
    path.unlink()
