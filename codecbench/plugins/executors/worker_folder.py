"""The folder with the files of a pool's workers: held while the pool lives, removed by the next pool after a kill."""

from __future__ import annotations

from typing import Final

from codecbench.core.contracts.held_folder import HeldFolder
from codecbench.plugins.executors.isolation import WorkerFiles

_PREFIX: Final = "codecbench-workers-"
_ROOM_BYTES: Final = 1 << 16


class WorkerFolder(HeldFolder):
    """A new folder in `parent`, by default the system's for temporary files. Raises OSError on a full disk.

    Folders that pools left whose process was killed are removed first.
    """

    def __init__(self, parent: str | None = None) -> None:
        super().__init__(_PREFIX, parent)
        room = self.path / "room"
        try:  # on a full disk every worker would end before it began
            with open(room, "w", encoding="ascii") as file:
                file.write("\0" * _ROOM_BYTES)
            room.unlink()
        except OSError as error:
            self.remove()
            error.filename = str(self.path.parent)
            raise

    def files(self, number: int) -> WorkerFiles:
        """Where the worker of this number keeps its files."""
        return WorkerFiles(*(self.path / f"{number}.{ending}" for ending in ("json", "out", "tmp")))
