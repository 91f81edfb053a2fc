"""Which settings of a run pass the criteria, and the lowest rate at which each curve still does."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import Final, TypeVar

import numpy as np

from codecbench.core.analysis.curve_values import curve_values, objection
from codecbench.core.analysis.evidence import FEWEST_FRAMES, Evidence, combine, evidence_of_frames, evidence_of_repeats
from codecbench.core.analysis.passing import Joint, Level, Standing, Test, describe, parts
from codecbench.core.analysis.run_result import Column, Key, RunResult, judged_column, successes, uses_link
from codecbench.core.analysis.table import CellResult, by_row
from codecbench.core.analysis.verdicts import Place, Points, SequenceCurve, values_in, values_of_repeats

NEAR_RAW: Final = {"higher": 0.8, "lower": 2.0}
"""The bound over the raw frames' value, by the better direction, for metrics that declare none."""

POOLED: Final = ""
"""Means all sequences together, in place of a sequence's name."""

T = TypeVar("T")
U = TypeVar("U")


@dataclass(frozen=True)
class Limit:
    """The settings of a curve with their tests, and the last of them that pass."""

    settings: tuple[Test, ...] = ()
    """From the highest rate to the lowest."""
    reason: str = ""
    """Why there are no settings."""

    @property
    def lowest(self) -> Test | None:
        """The setting of lowest rate that passes together with every setting of higher rate."""
        passing = list(takewhile(lambda setting: setting.verdict == "passes", self.settings))
        return passing[-1] if passing else None

    @property
    def rate(self) -> float:
        """The rate of the lowest setting that passes; infinite if there is none."""
        return float("inf") if self.lowest is None else self.lowest.rate

    @property
    def next(self) -> Test | None:
        """The first setting that does not pass; None if all pass."""
        return next((setting for setting in self.settings if setting.verdict != "passes"), None)

    @property
    def out_of_order(self) -> tuple[Test, ...]:
        """Settings that fail although one of lower rate passes."""
        passing = [place for place, setting in enumerate(self.settings) if setting.verdict == "passes"]
        return tuple(setting for setting in self.settings[: max(passing, default=0)] if setting.verdict == "fails")

    def after_words(self) -> str:
        """Describe the setting after the limit, and whether it is out of order."""
        after = self.next
        if after is None:
            return "nothing coarser was tried"
        name = after.point or "its setting"
        if after.verdict == "inconclusive":
            return f"{name} is inconclusive ({describe(after)})"
        words = f"{name} fails ({describe(after)})"
        if after in self.out_of_order:
            again = [
                setting.point for setting in self.settings if setting.verdict == "passes" and setting.rate < after.rate
            ]
            words += f"; out of order: {', '.join(again)} passes at a lower rate"
        return words


def criteria(run: RunResult) -> list[list[Column]]:
    """The columns that a setting has to pass, one list for each evaluator that measures success.

    A list has that success and every task of another evaluator whose metric declares how much is enough. If no success
    is measured, it is the first task, or else the first quality. A success that every run lacks counts only without
    such a task: then nothing is judged, and its reason says why. `choosing` judges what comes over a link.
    """
    groups = [group for group in successes(run) if not uses_link(group[0])]
    tasks = [column for column in run.headlines("task") if column.metric.enough is not None and not uses_link(column)]
    judged = [group for group in groups if all(run.wide[column.name].notna().any() for column in group)]
    if groups and not judged:
        return [tasks[:1]] if tasks else groups
    if judged:
        return [[*group, *(task for task in tasks if task.evaluator != group[0].evaluator)] for group in judged]
    column = judged_column(run)
    return [] if column is None or uses_link(column) else [[column]]


def limits(run: RunResult, columns: Sequence[Column]) -> dict[SequenceCurve, Limit]:
    """The limit of each curve on each sequence, see `tests_of`.

    With several sequences there is also a limit over all of them, under POOLED; a setting fails there if it fails on
    one.
    """
    run = run.as_calibrated
    by_curve = limits_of(_drop_partial_passes(tests_of(run, columns)), run.curves)
    if run.rate is None:
        no_rate = Limit(reason="no rate was measured; add an evaluator with a primary metric of role rate")
        return dict.fromkeys(by_curve, no_rate)
    return {key: _fail_if_any_fails(key, limit, by_curve) for key, limit in by_curve.items()}


def tests_of(run: RunResult, columns: Sequence[Column]) -> dict[Key, Test]:
    """The tests of each setting on each sequence and over all; a setting has to pass by all columns.

    A run succeeds if it does in all columns of role `success`. By every other column, the mean has to be on the right
    side of the bound.
    """
    counted = [column for column in columns if column.metric.role == "success"]
    tests: dict[Key, dict[str, Test]] = defaultdict(dict)
    for row, standing in (_standings(run, counted) if counted else {}).items():
        tests[row][standing.label] = standing
    for column in columns:
        if column not in counted:
            for row, level in _levels(run, column).items():
                tests[row][level.label] = level
    several = any(len(named) > 1 for named in tests.values())
    return {row: Joint(named) if several else next(iter(named.values())) for row, named in tests.items()}


def _drop_partial_passes(tests: Mapping[Key, Test]) -> dict[Key, Test]:
    """Drop settings that would pass but of which less was measured than of others.

    A search measures no more than it needs, and what is missing might fail."""
    sizes: dict[Key, int] = Counter()
    for row, test in tests.items():
        if row[0] != POOLED:
            for on in (row[0], POOLED):
                sizes[on, *row[1:]] += len(list(parts(test)))
    most: dict[str, int] = {}
    for (on, *_), size in sizes.items():
        most[on] = max(size, most.get(on, 0))
    return {row: test for row, test in tests.items() if test.verdict != "passes" or sizes[row] == most[row[0]]}


def _fail_if_any_fails(key: SequenceCurve, limit: Limit, by_curve: Mapping[SequenceCurve, Limit]) -> Limit:
    """In the limit over all sequences, let settings fail that fail on one; a limit of one sequence stays as it is."""
    if key[0] != POOLED:
        return limit
    settings: list[Test] = []
    for setting in limit.settings:
        failed = {sequence: test for (sequence, curve), other in by_curve.items()
                  if curve == key[1] and sequence != POOLED for test in other.settings
                  if test.point == setting.point and test.verdict == "fails"}  # fmt: skip
        passes = setting.verdict != "fails"
        settings.append(Joint({"all sequences together": setting, **failed}) if failed and passes else setting)
    return replace(limit, settings=tuple(settings))


def limits_of(tests: Mapping[Key, Test], points: Points) -> dict[SequenceCurve, Limit]:
    """The limit of each curve by (sequence, curve), with a reason if there is none.

    A curve with a setting of unknown rate has no limit, because that setting's place in the sweep is unknown.
    """
    curves: dict[SequenceCurve, list[Test]] = defaultdict(list)
    for (sequence, codec, setting), test in tests.items():
        curves[sequence, points[codec, setting].curve].append(test)
    return {key: _limit(members) for key, members in curves.items()}


def _limit(members: list[Test]) -> Limit:
    if empty := next((test for member in members for test in parts(member) if is_empty(test)), None):
        return Limit(reason=empty.why or "its runs cannot be judged here")
    if unknown := [member.point or "its setting" for member in members if np.isnan(member.rate)]:
        return Limit(reason=f"unknown rate: {', '.join(unknown)}")
    return Limit(tuple(sorted(members, key=lambda member: -member.rate)))


def is_empty(test: Standing | Level) -> bool:
    """Whether a test has no runs or values."""
    return test.runs == 0 if isinstance(test, Standing) else test.margin.count == 0


def pooled_rates(run: RunResult) -> dict[Key, float]:
    """The mean rate over sequences of each setting, by its row of the sequence POOLED; NaN if one is unknown."""
    return _pool(run.as_calibrated.rates, lambda rates: float(np.mean(rates)))


def _pool(rows: Mapping[Key, T], merge: Callable[[list[T]], U]) -> dict[Key, U]:
    settings: dict[tuple[str, str], list[T]] = defaultdict(list)
    for (_, codec, label), value in rows.items():
        settings[codec, label].append(value)
    return {(POOLED, codec, label): merge(values) for (codec, label), values in settings.items()}


def _with_pooled(rows: Mapping[Key, T], merge: Callable[[list[T]], T]) -> dict[Key, T]:
    """Add the rows over all sequences, if there are several."""
    return {**rows, **_pool(rows, merge)} if len({row[0] for row in rows}) > 1 else dict(rows)


def joint_values(columns: Sequence[Mapping[Key, Mapping[Place, float]]]) -> dict[Key, list[float]]:
    """The least of several columns' values at each place of a row; NaN if a column lacks it.

    Places at which no row of a sequence has a value, not even the baseline's, are left out.
    """
    least: dict[Key, dict[Place, float]] = {}
    judged: set[tuple[str, Place]] = set()
    for row in dict.fromkeys(row for column in columns for row in column):
        values = [column.get(row, {}) for column in columns]
        places = sorted({place for column in values for place in column})
        least[row] = {place: float(np.min([column.get(place, np.nan) for column in values])) for place in places}
        judged |= {(row[0], place) for place, value in least[row].items() if not np.isnan(value)}
    return {
        row: [value for place, value in values.items() if (row[0], place) in judged] for row, values in least.items()
    }


def _standings(run: RunResult, columns: Sequence[Column]) -> dict[Key, Standing]:
    """Count how often the runs of each row succeeded; a missing value counts as a run without success."""
    values = joint_values([values_of_repeats(run, column, failed=0.0) for column in columns])
    runs = by_row(result for result in run.results if result.cell.evaluator == columns[0].evaluator)
    names = {column.metric.name for column in columns}
    reasons = {good: {row: _reasons(runs[row], names, good=good) for row in values} for good in (True, False)}
    rates = _with_pooled(run.rates, lambda rates: float(np.mean(rates)))
    values = _with_pooled(values, lambda lists: [value for values in lists for value in values])
    why, asked = (_with_pooled(reasons[good], lambda counts: sum(counts, Counter())) for good in (False, True))
    label = " and ".join(column.label for column in columns)
    return {
        row: Standing(
            run.curves[row[1:]].point, rates.get(row, math.nan), sum(value == 1.0 for value in outcomes), len(outcomes),
            label, _commonest(why[row]), _in_common(asked[row]),
        )
        for row, outcomes in values.items()
    }  # fmt: skip


def _reasons(runs: Sequence[CellResult], names: Collection[str], *, good: bool) -> Counter[str]:
    """Count the reasons that metrics of these names gave for success (good), or for the lack of it."""
    counts: Counter[str] = Counter()
    for result in runs:
        reasons = [measured for measured in result.measurements if measured.metric in names and measured.reason]
        counts.update(str(measured.reason) for measured in reasons if (measured.value == 1.0) == good)
        if result.reason and not good:
            counts[result.reason] += 1
    return counts


def _commonest(reasons: Counter[str]) -> str:
    return reasons.most_common(1)[0][0] if reasons else ""


def _in_common(asked: Counter[str]) -> str:
    """What every run met; if sequences differ, without the values after a `=`."""
    return _commonest(asked if len(asked) == 1 else Counter(re.sub(r" = [^,;]*", "", text) for text in asked))


def _levels(run: RunResult, column: Column) -> dict[Key, Level]:
    """Compare each row with its bound; empty if neither the metric nor raw frames give one."""
    rows = by_row(run.of(column.evaluator.title))
    series = {row: _series(results, column) for row, results in rows.items()}
    raw = {row[0]: values for row, (values, _) in series.items() if row[1] in run.schema.baselines}
    objections = {sequence: _objection(run, column, sequence) for sequence in {row[0] for row in rows}}
    levels, wanted = {}, (column.evaluator, column.metric.shown_with)
    partner = next((c for c in run.columns.values() if c.is_usual and (c.evaluator, c.metric.name) == wanted), None)
    for row, (values, over_frames) in series.items():
        level = _level(column, values, raw.get(row[0]), over_frames)
        if level is not None:
            shown = np.empty(0) if partner is None else _series(rows[row], partner)[0]
            if partner is not None and not np.isnan(shown).all():
                level = replace(level, beside=(partner, float(np.nanmean(shown))))
            why = objections[row[0]]
            level = replace(level, margin=_NO_MARGIN, why=why) if why else level
            levels[row] = replace(level, point=run.curves[row[1:]].point, rate=run.rates.get(row, math.nan))
    return _with_pooled(levels, _average)


_NO_MARGIN: Final = Evidence(math.nan, math.nan, 0.0)


def _objection(run: RunResult, column: Column, sequence: str) -> str:
    """Say why a column is uninformative on a sequence, if its bound depends on the raw frames."""
    if column.metric.enough is not None or run.rate is None:
        return ""
    reason = objection(run, column, *curve_values(run, column, sequence))
    return f"{column.label} is uninformative on {sequence}: {reason}" if reason else ""


def _series(results: Sequence[CellResult], column: Column) -> tuple[np.ndarray, bool]:
    """The values of a row, and whether they are of frames, each the mean over repeats, or of repeats."""
    if all((column.metric.name, column.stage, column.aggregate) in result.summaries for result in results):
        frames = [result.values_of_frames(column.metric.name, column.stage) for result in results]
        return np.mean(frames, axis=0), True
    return np.array([value for result in results for value in values_in(result, column)]), False


def _level(column: Column, values: np.ndarray, raw: np.ndarray | None, over_frames: bool) -> Level | None:
    """Compare values with their bound, without frames that the raw codec lacks too; None if there is no bound."""
    metric = column.metric
    if over_frames and raw is not None:
        values, raw = values[~np.isnan(raw)], raw[~np.isnan(raw)]
    if metric.enough is not None:
        bound = np.full(len(values), metric.enough)
    elif raw is None or not len(raw) or metric.better == "neither":
        return None
    else:
        bound = NEAR_RAW[metric.better] * (raw if over_frames else np.full(len(values), np.nanmean(raw)))
    limit = float(bound.mean()) if len(bound) else math.nan
    if not 0.0 < limit < math.inf:
        return None
    there = ~np.isnan(values)
    finite = np.where(np.isinf(values), 2.0 * limit, values)  # PSNR of equal images is infinite
    margins = (finite - bound)[there] * (1.0 if metric.better == "higher" else -1.0)
    correlated = over_frames and len(margins) >= FEWEST_FRAMES  # fewer count as independent frames
    margin = _NO_MARGIN
    if len(margins):
        margin = evidence_of_frames(margins, halved=False) if correlated else evidence_of_repeats(margins)
    value = float(values[there].mean()) if len(margins) else math.nan
    missing = np.count_nonzero(~there)
    why = f"{missing} of {len(there)} values of {column.label} are missing" if missing else ""
    return Level("", math.nan, column, value, limit, margin, why)


def _average(levels: list[Level]) -> Level:
    """Average a setting's levels over the sequences on which it can be judged."""
    rate = float(np.mean([level.rate for level in levels]))
    levels = [level for level in levels if level.margin.count] or levels[:1]
    return replace(
        levels[0],
        rate=rate,
        value=float(np.mean([level.value for level in levels])),
        bound=float(np.mean([level.bound for level in levels])),
        margin=combine([level.margin for level in levels]),
        beside=levels[0].beside and (levels[0].beside[0], float(np.mean([lv.beside[1] for lv in levels if lv.beside]))),
        why=next((level.why for level in levels if level.why), ""),
    )
