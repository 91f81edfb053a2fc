"""How far the work on a sequence has got, and the error of a codec that does not do what its contract says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from codecbench.core.contracts.errors import CodecbenchError

WRITE: Final = "write"
"""The stage at which the engine writes the file of bitstreams, and no code of a plugin runs."""


class CodingError(CodecbenchError):
    """A codec returned something that is not a bitstream, not the stream's packet, or not the picture's shape."""


@dataclass
class WorkPosition:
    """Where in a sequence the work has got to, for the reason of a failure: `encode, frame 17`.

    titles: of the plugins of other distributions, by the stage at which their code runs.
    """

    stage: str = ""
    frame: int | None = None
    titles: Mapping[str, str] = field(default_factory=dict)

    def at(self, stage: str, frame: int | None = None) -> None:
        self.stage, self.frame = str(stage), frame  # a host may have said so

    def __str__(self) -> str:
        place = self.stage if self.frame is None else f"{self.stage}, frame {self.frame}"
        return f"{self.titles[self.stage]}: {place}" if self.stage in self.titles else place
