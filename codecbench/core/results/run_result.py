"""A run as its user holds it: the plan, what became of each cell, and the tables."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from html import escape
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from codecbench.core.contracts.errors import ParamsError
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.contracts.metric import Role
from codecbench.core.engine.planning.model import Plan
from codecbench.core.results.columns import Column, columns_of
from codecbench.core.results.curves import CurvePoint, curve_points
from codecbench.core.results.meaning import Meaning
from codecbench.core.results.style import CurveStyle, curve_styles
from codecbench.core.results.table import CellResult, tidy, wide

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from codecbench.core.results.answers import Answers
    from codecbench.core.results.ranking.ranking import Ranked

Key = tuple[str, str, str]
"""Sequence, codec and setting: a row of the wide table."""


@dataclass(frozen=True, repr=False)
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

    def __repr__(self) -> str:
        """Three lines: what was run, what became of it, and by what it is judged."""
        sequences = ", ".join(f"{entry.name} ({entry.frames} frames)" for entry in self.plan.sequences)
        counts = Counter(result.status for result in self.results)
        became = ", ".join(f"{count} {status}" for status, count in sorted(counts.items())) or "none"
        to_do = f", {self.missing} to do" if self.missing else ""
        codecs = ", ".join(dict.fromkeys(cell.codec.name for cell in self.plan.cells))
        return f"run {self.plan.name} in {self.folder}\n{codecs} on {sequences}\ncells: {became}{to_do}"

    def _repr_html_(self) -> str:
        """The headlines as a table and what is noted beside them, for notebooks."""
        from codecbench.core.results.export import short_table
        from codecbench.core.results.notes import notes

        table = short_table(self).to_html(
            index=False, na_rep="–", float_format=lambda value: f"{value:.4g}".replace("inf", "∞")
        )
        return "\n".join([str(table), *(f"<p>{escape(note)}</p>" for note in notes(self))])

    def plot(self, what: str = "", sequence: str | None = None) -> Figure:
        """A figure of the run: `rate-ate` is the trajectory error over the rate.

        what: words of the two axes' metrics with a hyphen between; by default what codecs are judged by, over the rate.
        sequence: its name; by default the first. Raises ParamsError, with what there is, where there is no such figure.
        """
        from codecbench.core.results.one_figure import one_figure

        return one_figure(self, what, sequence)

    def report(self, path: str | Path | None = None, *, frames: Collection[int] = ()) -> Path:
        """Write the report as one HTML page and return its path, by default `report/report.html` in the run folder.

        frames: numbers of the frames to show, from 0; by default a few. Raises ParamsError for one that is not there.
        """
        from codecbench.core.results.report.write import write_report

        page = self.folder / "report" / "report.html" if path is None else Path(path)
        write_report(self, page, frames=frames)
        return page

    def best(self, rate: float | None = None) -> Answers | Ranked:
        """What to take. Without a rate a sentence a codec; at a rate, in the unit that people are shown, the codec.

        Raises ParamsError for what is no rate, and where nothing can be ranked at it.
        """
        from codecbench.core.results.answers import answers
        from codecbench.core.results.ranking.ranking import rankings

        if rate is None:
            return answers(self)
        if isinstance(rate, bool) or not isinstance(rate, Real) or not 0.0 < rate < math.inf:
            unit = "" if self.rate is None else f" in {self.rate.unit}"
            raise ParamsError(
                f"best({rate!r}): give a rate above 0{unit}, as a number, or nothing for a sentence a codec; "
                "`wide` and `tidy` are the tables with every column"
            )
        found = rankings(self, brief=True, at=rate / self.rate.factor) if self.rate is not None else []
        if not found:
            raise ParamsError("nothing can be ranked at that rate: no two codecs have settings around it")
        return found[0].taken

    def frames(self, codec: str, setting: str | Mapping[str, Any] = "", sequence: str | None = None) -> CodedSequence:
        """The frames of a codec setting beside what was decoded of them, from the bitstreams in the run folder.

        setting: as in the tables, `quality=10`, or parameters, {"quality": 10}; it may be left out where there is one.
        Opens the sequence. Raises
        ParamsError where the run has no such setting, and DatasetError where the sequence is no longer that of the run.
        """
        from codecbench.core.results.stored_frames import stored_frames

        return stored_frames(self, codec, setting, sequence)

    def of(self, evaluator: str) -> list[CellResult]:
        """The cells that were computed of an evaluator, by its name, or of one of its settings, by its title."""
        return [
            result
            for result in self.results
            if result.status == "ok" and evaluator in (result.cell.evaluator.name, result.cell.evaluator.title)
        ]
