"""A run as data: its plan, what became of each cell, the tables, and the curves that its settings belong to."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from codecbench.core.analysis.columns import Column, columns_of
from codecbench.core.analysis.table import CellResult, tidy, wide
from codecbench.core.contracts.metric import Metric, Role
from codecbench.core.contracts.view import View
from codecbench.core.engine.planning.model import Plan, PluginSetting
from codecbench.core.engine.text import counted

Key = tuple[str, str, str]
"""Sequence, codec and setting: a row of the wide table."""


@dataclass(frozen=True)
class RunSchema:
    """What a run's plugins declared.

    metrics, views: by the title of an evaluator's setting. baselines, anchors: names of codecs. stateless: by codec,
    whether it codes each picture on its own; without those of which the plan does not say it.
    """

    metrics: Mapping[str, Mapping[str, Metric]]
    views: Mapping[str, tuple[View, ...]]
    baselines: frozenset[str] = frozenset()
    anchors: tuple[str, ...] = ()
    stateless: Mapping[str, bool] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class RunResult:
    """A run folder, read.

    results: one entry a cell that has a record, in the order of the plan. environments: what is known of the
    machines that computed them, by identity. schema: what its evaluators and codecs declared.
    """

    folder: Path
    plan: Plan
    results: tuple[CellResult, ...]
    environments: dict[str, dict[str, Any]]
    schema: RunSchema

    @cached_property
    def as_calibrated(self) -> Self:
        """The run without the sequences that are others of it under a wrong calibration, by which nothing is judged."""
        known = {entry.fingerprint for entry in self.plan.sequences}
        sequences = tuple(entry for entry in self.plan.sequences if entry.as_calibrated not in known)
        names = {entry.name for entry in sequences}
        if len(names) == len(self.plan.sequences):
            return self
        cells = tuple(cell for cell in self.plan.cells if cell.sequence.name in names)
        results = tuple(result for result in self.results if result.cell.sequence.name in names)
        found = replace(self, plan=replace(self.plan, sequences=sequences, cells=cells), results=results)
        vars(found)["curves"] = self.curves  # called by the settings of the whole run
        return found

    @cached_property
    def tidy(self) -> pd.DataFrame:
        """One row a measurement; see `codecbench.core.analysis.table.tidy`."""
        return tidy(self.results)

    @cached_property
    def wide(self) -> pd.DataFrame:
        """One row for each sequence and codec setting; see `codecbench.core.analysis.table.wide`."""
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
    def rows(self) -> list[Key]:
        """The rows of the wide table, in order."""
        return list(dict.fromkeys(result.row for result in self.results))

    @cached_property
    def rates(self) -> dict[Key, float]:
        """The rate of every row of the wide table; NaN where it is not known."""
        values = self.wide[self.rate.name] if self.rate else np.full(len(self.wide), np.nan)
        return dict(zip(self.rows, map(float, values), strict=True))

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
        sequences = ", ".join(f"{entry.name} ({counted(entry.frames, 'frame')})" for entry in self.plan.sequences)
        counts = Counter(result.status for result in self.results)
        became = ", ".join(f"{count} {status}" for status, count in sorted(counts.items())) or "none"
        to_do = f", {self.missing} to do" if self.missing else ""
        codecs = ", ".join(dict.fromkeys(cell.codec.name for cell in self.plan.cells))
        return f"run {self.plan.name} in {self.folder}\n{codecs} on {sequences}\ncells: {became}{to_do}"

    def of(self, evaluator: str) -> list[CellResult]:
        """The cells that were computed of an evaluator, by its name, or of one of its settings, by its title."""
        return [
            result
            for result in self.results
            if result.status == "ok" and evaluator in (result.cell.evaluator.name, result.cell.evaluator.title)
        ]


@dataclass(frozen=True)
class CurvePoint:
    """Where a setting stands: `curve` names the codec and what is held fixed, `point` what is swept.

    place: the value that is swept, by which the settings of a curve stand in order; 0 where nothing is.
    """

    curve: str
    point: str
    place: float = 0.0


def curve_points(settings: Iterable[PluginSetting]) -> dict[tuple[str, str], CurvePoint]:
    """The curve of each codec setting, by codec name and label.

    A codec's swept parameter is the number that takes most values over its settings; the other parameters
    that differ name the curve: `qf=5 levels=2` is point `qf=5` of the curve `multilevel levels=2`.
    """
    by_codec: dict[str, dict[str, PluginSetting]] = defaultdict(dict)
    for setting in settings:
        by_codec[setting.name].setdefault(setting.label, setting)
    points = {}
    for codec, members in by_codec.items():
        swept = _swept([setting.params for setting in members.values()])
        for label, setting in members.items():
            words = label.split(" ") if label else []
            held = [word for word in words if not (swept and word.startswith(f"{swept}="))]
            if len(members) == 1:
                points[codec, label] = CurvePoint(codec, label)
            else:
                point = " ".join(word for word in words if word not in held)
                value = setting.params.get(swept) if swept else None
                place = float(value) if isinstance(value, int | float) else 0.0
                points[codec, label] = CurvePoint(" ".join([codec, *held]), point, place)
    return points


def _swept(params: list[dict[str, object]]) -> str | None:
    """The numeric parameter with most different values; of equals the first."""
    best, most = None, 1
    for key in params[0] if params else ():
        values = [setting.get(key) for setting in params]
        numbers = {value for value in values if isinstance(value, int | float) and not isinstance(value, bool)}
        if len(numbers) > most:
            best, most = key, len(numbers)
    return best


def judged_column(run: RunResult) -> Column | None:
    """The column of the curve that belongs to the answers: of a task whose success is judged, else the first task.

    Of an evaluator that uses a link, the error that is made of what comes over it.
    """
    judged, tasks = successes(run), run.headlines("task")
    if judged:
        tasks = [column for column in tasks if column.evaluator == judged[0][0].evaluator] or tasks
    linked = [column for column in tasks if over_link(column)]
    erring = [column for column in linked if column.metric.quantity == "error"]
    ranked = [column for column in (*erring, *tasks, *run.headlines("quality")) if column.metric.better != "neither"]
    return next(iter(ranked), None)


def successes(run: RunResult) -> list[list[Column]]:
    """Headlines of role `success` by evaluator: a run counts that succeeds in all.

    If the baseline was run, a success that no run has a value of is among them: nothing can be judged by it then.
    """
    known = run.headlines("success")
    beside = {
        each.cell.evaluator for each in run.results if each.status == "ok" and each.row[1] in run.schema.baselines
    }
    asked = beside & {column.evaluator for column in known if not over_link(column)}
    found: dict[str, list[Column]] = defaultdict(list)
    for column in run.columns.values():
        if column in known or (column.evaluator in asked and column.is_headline and column.metric.role == "success"):
            found[column.evaluator.title].append(column)
    return list(found.values())


def over_link(column: Column) -> bool:
    """Whether it is measured of what comes over a link."""
    return any(used.kind == "link" for used in column.evaluator.uses)
