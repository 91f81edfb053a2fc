"""What a run says of itself when it has ended."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class RunSummary:
    """How a run ended.

    statuses: how many cells of the plan have which status now. computed: cells computed by this run. kept:
    cells that an earlier run had computed. encoded: coding jobs done. interrupted: the signal that ended the
    run early, or None. damaged: what was found damaged and why, by cell. notices: what was said of kept cells.
    """

    folder: Path
    statuses: dict[str, int]
    computed: int
    kept: int
    encoded: int
    interrupted: str | None = None
    damaged: dict[str, str] = field(default_factory=dict)
    notices: tuple[str, ...] = ()
