"""A run as its user holds it: the plan, what became of each cell, and the tables."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from codecbench.core.contracts.metric import Role
from codecbench.core.engine.planning.model import Plan
from codecbench.core.results.columns import Column, columns_of
from codecbench.core.results.curves import CurvePoint, curve_points
from codecbench.core.results.meaning import Meaning
from codecbench.core.results.style import CurveStyle, curve_styles
from codecbench.core.results.table import CellResult, tidy, wide

Key = tuple[str, str, str]
"""Sequence, codec and setting: a row of the wide table."""


@dataclass(frozen=True)
class RunResult:
    """A run folder, read.

    results: one entry a cell that has a record, in the order of the plan. environments: what is known of the
    machines that computed them, by identity. meaning: what its evaluators and codecs declared.
    """

    folder: Path
    plan: Plan
    results: tuple[CellResult, ...]
    environments: dict[str, dict[str, Any]]
    meaning: Meaning

    @cached_property
    def tidy(self) -> pd.DataFrame:
        """One row a measurement; see `codecbench.core.results.table.tidy`."""
        return tidy(self.results)

    @cached_property
    def wide(self) -> pd.DataFrame:
        """One row for each sequence and codec setting; see `codecbench.core.results.table.wide`."""
        return wide(self.results)

    @cached_property
    def columns(self) -> dict[str, Column]:
        """What each measured column of the wide table is, by name, in the order of evaluators and their metrics."""
        present = set(self.wide.columns)
        return {name: column for name, column in columns_of(self.results).items() if name in present}

    @cached_property
    def curves(self) -> dict[tuple[str, str], CurvePoint]:
        """The curve that each codec setting belongs to, by codec name and label."""
        return curve_points(result.cell.codec for result in self.results)

    @cached_property
    def styles(self) -> dict[str, CurveStyle]:
        """How each curve is drawn."""
        return curve_styles((point.curve for point in self.curves.values()), self.meaning.baselines)

    def headlines(self, *roles: Role) -> list[Column]:
        """Columns that are shown first, of these roles or of all, that have a value somewhere."""
        return [
            column
            for name, column in self.columns.items()
            if column.is_headline and (not roles or column.metric.role in roles) and self.wide[name].notna().any()
        ]

    @cached_property
    def rate(self) -> Column | None:
        """What codecs spend, by which curves are drawn and limits sought; None where the run did not measure it."""
        return next((column for column in self.headlines("rate") if column.metric.better == "lower"), None)

    @cached_property
    def rates(self) -> dict[Key, float]:
        """The rate of every row of the wide table; NaN where it is not known."""
        keys = (
            zip(*(self.wide[name] for name in ("sequence", "codec", "setting")), strict=True) if len(self.wide) else ()
        )
        values = self.wide[self.rate.name] if self.rate else np.full(len(self.wide), np.nan)
        return {key: float(value) for key, value in zip(keys, values, strict=True)}

    @property
    def failed(self) -> list[CellResult]:
        """Cells that were to be computed and were not; `unsupported` is not a failure."""
        return [result for result in self.results if result.status not in ("ok", "unsupported")]

    @property
    def missing(self) -> int:
        """Cells of the plan that have no record yet."""
        return len(self.plan.cells) - len(self.results)

    def of(self, evaluator: str) -> list[CellResult]:
        """The cells that were computed of an evaluator, by its name, or of one of its settings, by its title."""
        return [
            result
            for result in self.results
            if result.status == "ok" and evaluator in (result.cell.evaluator.name, result.cell.evaluator.title)
        ]
