"""A run as data: its plan, the results of its cells, the columns of its tables, and the curves of its settings."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
import pandas as pd

from codecbench.core.analysis.table import CellResult, tidy, wide
from codecbench.core.contracts.metric import Metric, Role
from codecbench.core.contracts.view import View
from codecbench.core.engine.planning.model import Plan, PluginSetting
from codecbench.core.engine.text import counted


@dataclass(frozen=True)
class Column:
    """An aggregate of an evaluator's metric, of one stage or of none ("")."""

    evaluator: PluginSetting
    metric: Metric
    stage: str
    aggregate: str

    @property
    def name(self) -> str:
        """The name in the wide table: `evaluator.metric[.stage].aggregate`."""
        return f"{self.evaluator.title}.{self.measure}.{self.aggregate}"

    @property
    def measure(self) -> str:
        """The metric with its stage: `metric[.stage]`."""
        return f"{self.metric.name}.{self.stage}" if self.stage else self.metric.name

    @property
    def label(self) -> str:
        """The stage, the metric, the evaluator's setting, and the aggregate if it is not the usual one, in words."""
        words = f"{self.stage} {self.metric.label}" if self.stage else self.metric.label
        setting = f" ({self.evaluator.label})" if self.evaluator.label else ""
        return words + setting + ("" if self.is_usual else f", {self.aggregate}")

    @property
    def heading(self) -> str:
        """The label with the displayed unit."""
        return f"{self.label} [{self.unit}]" if self.unit not in ("", "1") else self.label

    @property
    def short_heading(self) -> str:
        """A narrow heading of one line or more."""
        return "\n".join(filter(None, (self.stage, self.metric.column_header, self.evaluator.label)))

    @property
    def unit(self) -> str:
        """The displayed unit; empty for a count of values."""
        return "" if self.aggregate == "infinite" else self.metric.display_unit

    @property
    def factor(self) -> float:
        """The factor from a value of the table to `unit`."""
        return 1.0 if self.aggregate == "infinite" else self.metric.display_factor

    @property
    def better(self) -> str:
        """The better direction of displayed values, which is the metric's unless the factor is negative."""
        turned = {"lower": "higher", "higher": "lower"} if self.factor < 0 else {}
        return turned.get(self.metric.better, self.metric.better)

    @property
    def is_usual(self) -> bool:
        """Whether this is the metric's first aggregate, which stands for the metric."""
        return self.aggregate == self.metric.aggregates[0]

    @property
    def is_headline(self) -> bool:
        """Whether it is shown first: the usual aggregate of a headline metric, not of a part (`encode/dct`)."""
        return self.metric.headline and self.is_usual and "/" not in self.stage


def columns_of(results: Iterable[CellResult]) -> dict[str, Column]:
    """Every column that the wide table of these results can have, by name.

    Their order is that of the evaluators, then that of each evaluator's metrics.
    """
    by_metric: dict[tuple[PluginSetting, str], dict[tuple[str, str, str], Column]] = {}
    declared: dict[PluginSetting, dict[str, Metric]] = {}
    for result in results:
        setting = result.cell.evaluator
        metrics = declared.setdefault(setting, {})
        metrics.update(result.metrics)
        keys = [*result.summaries, *_single(result)]
        for name, stage, how in keys:
            metric = metrics.get(name) or Metric(name, "", "neither", "")
            by_metric.setdefault((setting, name), {}).setdefault(
                (name, stage, how), Column(setting, metric, stage, how)
            )
    ordered: dict[str, Column] = {}
    for setting, metrics in declared.items():
        undeclared = [name for owner, name in by_metric if owner == setting and name not in metrics]
        for name in (*metrics, *undeclared):
            ordered |= {column.name: column for column in by_metric.get((setting, name), {}).values()}
    return ordered


def _single(result: CellResult) -> Iterable[tuple[str, str, str]]:
    """Keys (metric, stage, aggregate) of what was measured once a repeat."""
    for measured in result.measurements:
        metric = result.metrics.get(measured.metric)
        for how in metric.aggregates if metric else ("mean",):
            yield measured.metric, measured.stage or "", how


Key = tuple[str, str, str]
"""Sequence, codec and setting: a row of the wide table."""


@dataclass(frozen=True)
class RunSchema:
    """What a run's plugins declared."""

    metrics: Mapping[str, Mapping[str, Metric]]
    """By the title of an evaluator's setting."""
    views: Mapping[str, tuple[View, ...]]
    """By the title of an evaluator's setting."""
    baselines: frozenset[str] = frozenset()
    """Names of codecs."""
    anchors: tuple[str, ...] = ()
    """Names of codecs."""
    stateless: Mapping[str, bool] = field(default_factory=dict)
    """By codec, whether it codes each frame on its own, if the plan says so."""


@dataclass(frozen=True, repr=False)
class RunResult:
    """The contents of a run folder."""

    folder: Path
    plan: Plan
    results: tuple[CellResult, ...]
    """One a cell that has a record, in the order of the plan."""
    environments: dict[str, dict[str, Any]]
    """Descriptions of the machines that computed them, by identity."""
    schema: RunSchema
    """What its evaluators and codecs declared."""

    @cached_property
    def as_calibrated(self) -> Self:
        """The run without sequences that repeat another one under a wrong calibration."""
        known = {entry.fingerprint for entry in self.plan.sequences}
        sequences = tuple(entry for entry in self.plan.sequences if entry.as_calibrated not in known)
        names = {entry.name for entry in sequences}
        if len(names) == len(self.plan.sequences):
            return self
        cells = tuple(cell for cell in self.plan.cells if cell.sequence.name in names)
        results = tuple(result for result in self.results if result.cell.sequence.name in names)
        run = replace(self, plan=replace(self.plan, sequences=sequences, cells=cells), results=results)
        vars(run)["curves"] = self.curves  # named by the settings of the whole run
        return run

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
        """The measured columns of the wide table, by name, in the order of evaluators and their metrics."""
        present = set(self.wide.columns)
        return {name: column for name, column in columns_of(self.results).items() if name in present}

    @cached_property
    def curves(self) -> dict[tuple[str, str], CurvePoint]:
        """The curve point of each codec setting, by codec name and label."""
        return curve_points(result.cell.codec for result in self.results)

    def headlines(self, *roles: Role) -> list[Column]:
        """The headline columns that have a value somewhere, of these roles or of all."""
        return [
            column
            for name, column in self.columns.items()
            if column.is_headline and (not roles or column.metric.role in roles) and self.wide[name].notna().any()
        ]

    @cached_property
    def rate(self) -> Column | None:
        """The rate that curves and limits use; None if the run did not measure one."""
        return next((column for column in self.headlines("rate") if column.metric.better == "lower"), None)

    @cached_property
    def rows(self) -> list[Key]:
        """The rows of the wide table, in order."""
        return list(dict.fromkeys(result.row for result in self.results))

    @cached_property
    def rates(self) -> dict[Key, float]:
        """The rate of every row of the wide table; NaN if unknown."""
        values = self.wide[self.rate.name] if self.rate else np.full(len(self.wide), np.nan)
        return dict(zip(self.rows, map(float, values), strict=True))

    @property
    def failed(self) -> list[CellResult]:
        """Cells whose computation failed; `unsupported` is not a failure."""
        return [result for result in self.results if result.status not in ("ok", "unsupported")]

    @property
    def missing(self) -> int:
        """Cells of the plan that have no record yet."""
        return len(self.plan.cells) - len(self.results)

    def __repr__(self) -> str:
        """Three lines: the run, its codecs and sequences, and the states of its cells."""
        sequences = ", ".join(f"{entry.name} ({counted(entry.frames, 'frame')})" for entry in self.plan.sequences)
        counts = Counter(result.status for result in self.results)
        became = ", ".join(f"{count} {status}" for status, count in sorted(counts.items())) or "none"
        to_do = f", {self.missing} to do" if self.missing else ""
        codecs = ", ".join(dict.fromkeys(cell.codec.name for cell in self.plan.cells))
        return f"run {self.plan.name} in {self.folder}\n{codecs} on {sequences}\ncells: {became}{to_do}"

    def of(self, evaluator: str) -> list[CellResult]:
        """The computed cells of an evaluator, by its name, or of one of its settings, by its title."""
        return [
            result
            for result in self.results
            if result.status == "ok" and evaluator in (result.cell.evaluator.name, result.cell.evaluator.title)
        ]


@dataclass(frozen=True)
class CurvePoint:
    """The place of a setting on a curve."""

    curve: str
    """The codec and its fixed parameters."""
    point: str
    """The swept parameter."""
    place: float = 0.0
    """The value of the swept parameter, which orders the settings of a curve; 0 if there is none."""


def curve_points(settings: Iterable[PluginSetting]) -> dict[tuple[str, str], CurvePoint]:
    """The curve point of each codec setting, by codec name and label.

    A codec's swept parameter is the number with most values over its settings. The other parameters that differ name
    the curve: `qf=5 levels=2` is point `qf=5` of the curve `multilevel levels=2`.
    """
    by_codec: dict[str, dict[str, PluginSetting]] = defaultdict(dict)
    for setting in settings:
        by_codec[setting.name].setdefault(setting.label, setting)
    points = {}
    for codec, members in by_codec.items():
        swept = _swept_parameter([setting.params for setting in members.values()])
        for label, setting in members.items():
            words = label.split(" ") if label else []
            fixed = [word for word in words if not (swept and word.startswith(f"{swept}="))]
            if len(members) == 1:
                points[codec, label] = CurvePoint(codec, label)
            else:
                point = " ".join(word for word in words if word not in fixed)
                value = setting.params.get(swept) if swept else None
                place = float(value) if isinstance(value, int | float) else 0.0
                points[codec, label] = CurvePoint(" ".join([codec, *fixed]), point, place)
    return points


def _swept_parameter(params: list[dict[str, object]]) -> str | None:
    """The first numeric parameter with most different values; None if none differs."""
    best, most = None, 1
    for key in params[0] if params else ():
        values = [setting.get(key) for setting in params]
        numbers = {value for value in values if isinstance(value, int | float) and not isinstance(value, bool)}
        if len(numbers) > most:
            best, most = key, len(numbers)
    return best


def judged_column(run: RunResult) -> Column | None:
    """The column that the answers' curve shows: the task whose success is judged, or else the first task or quality.

    For an evaluator that uses a link, it is the error of what comes over the link. None if there is no such column.
    """
    judged, tasks = successes(run), run.headlines("task")
    if judged:
        tasks = [column for column in tasks if column.evaluator == judged[0][0].evaluator] or tasks
    linked = [column for column in tasks if uses_link(column)]
    erring = [column for column in linked if column.metric.quantity == "error"]
    ranked = [column for column in (*erring, *tasks, *run.headlines("quality")) if column.metric.better != "neither"]
    return next(iter(ranked), None)


def successes(run: RunResult) -> list[list[Column]]:
    """The headlines of role `success`, one list an evaluator; a run has to succeed in all of a list.

    If the baseline was run, they include a success without any value, by which nothing can then be judged.
    """
    known = run.headlines("success")
    of_baselines = {
        result.cell.evaluator
        for result in run.results
        if result.status == "ok" and result.row[1] in run.schema.baselines
    }
    complete = of_baselines & {column.evaluator for column in known if not uses_link(column)}
    columns: dict[str, list[Column]] = defaultdict(list)
    for column in run.columns.values():
        if column in known or (column.evaluator in complete and column.is_headline and column.metric.role == "success"):
            columns[column.evaluator.title].append(column)
    return list(columns.values())


def uses_link(column: Column) -> bool:
    """Whether the column measures what comes over a link."""
    return any(used.kind == "link" for used in column.evaluator.uses)
