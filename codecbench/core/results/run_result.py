"""A run as its user holds it: the plan, what became of each cell, and the tables."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from codecbench.core.engine.planning.model import Plan
from codecbench.core.results.curves import CurvePoint, curve_points
from codecbench.core.results.table import CellResult, tidy, wide


@dataclass(frozen=True)
class RunResult:
    """A run folder, read.

    results: one entry a cell that has a record, in the order of the plan. environments: what is known of the
    machines that computed them, by identity.
    """

    folder: Path
    plan: Plan
    results: tuple[CellResult, ...]
    environments: dict[str, dict[str, Any]]

    @cached_property
    def tidy(self) -> pd.DataFrame:
        """One row a measurement; see `codecbench.core.results.table.tidy`."""
        return tidy(self.results)

    @cached_property
    def wide(self) -> pd.DataFrame:
        """One row for each sequence and codec setting; see `codecbench.core.results.table.wide`."""
        return wide(self.results)

    @cached_property
    def curves(self) -> dict[tuple[str, str], CurvePoint]:
        """The curve that each codec setting belongs to, by codec name and label."""
        return curve_points(result.cell.codec for result in self.results)

    @property
    def failed(self) -> list[CellResult]:
        """Cells that were to be computed and were not; `unsupported` is not a failure."""
        return [result for result in self.results if result.status not in ("ok", "unsupported")]

    @property
    def missing(self) -> int:
        """Cells of the plan that have no record yet."""
        return len(self.plan.cells) - len(self.results)

    def of(self, evaluator: str) -> list[CellResult]:
        """The cells of one evaluator that were computed."""
        return [result for result in self.results if result.cell.evaluator.name == evaluator and result.status == "ok"]
