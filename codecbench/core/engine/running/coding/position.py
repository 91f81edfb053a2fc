"""The progress of work on a sequence, and the error of a codec that violates its contract."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from codecbench.core.contracts.errors import CodecbenchError

WRITE: Final = "write"
"""Stage in which the engine writes the bitstream file and no plugin's code runs."""


class CodingError(CodecbenchError):
    """Raised if a codec returns something that is no bitstream, no packet of the stream, or has a wrong shape."""


@dataclass
class WorkPosition:
    """How far work on a sequence has got, for the reason of a failure: `encode, frame 17`."""

    stage: str = ""
    frame: int | None = None
    titles: Mapping[str, str] = field(default_factory=dict)
    """Plugins of other distributions by the stage at which their code runs."""

    def at(self, stage: str, frame: int | None = None) -> None:
        self.stage, self.frame = str(stage), frame  # a host may send any type

    def __str__(self) -> str:
        place = self.stage if self.frame is None else f"{self.stage}, frame {self.frame}"
        return f"{self.titles[self.stage]}: {place}" if self.stage in self.titles else place
