"""Loops and maps, which ORB-SLAM3 reports only by printing."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from codecbench.core.contracts.slam import LoopEvent

LOOP: Final = b"*Loop detected"
MERGE: Final = b"*Merge detected"
NEW_MAP: Final = b"New Map created"
UNKNOWN_FRAME: Final = -1


class PrintedEvents:
    """Reads a growing log: `loops` that were closed and the number of maps that were started."""

    def __init__(self, log: Path) -> None:
        self._log = log
        self._position = 0
        self.loops: list[LoopEvent] = []
        self.maps_started = 0

    def read(self, frame: int) -> None:
        """Take in the whole lines printed since the last call; they belong to the time of `frame`."""
        if not self._log.exists():
            return
        with self._log.open("rb") as stream:
            stream.seek(self._position)
            text = stream.read()
        whole = text.rfind(b"\n") + 1
        self._position += whole
        for line in text[:whole].splitlines():
            if LOOP in line or MERGE in line:
                self.loops.append(LoopEvent(frame, UNKNOWN_FRAME, 0, merged_maps=MERGE in line))
            self.maps_started += NEW_MAP in line
