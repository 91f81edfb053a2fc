"""Compares two runs series by series: better, worse, same, changed, or inconclusive.

Repeatable values (sizes, quality, operation counts) are compared exactly. Times are divided by the yardstick that
their metric names, which removes the machine's fluctuation, and tested over repeats. A change of times counts if the
exact Mann-Whitney test is significant (Mann and Whitney 1947, doi:10.1214/aoms/1177730491) and the median moved by more
than a tolerance. Other programs can lengthen wall-clock time for a whole run, unseen by a test within that run. So its
verdict stands only if its confirming metric, processor time, moved the same way.
"""

from __future__ import annotations

import fnmatch
import json
import math
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import scipy
from pydantic import TypeAdapter

from codecbench.core.analysis.collect import open_run
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.table import CellResult, json_value
from codecbench.core.contracts.errors import StoreError
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.identity import json_from_bytes
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.text import clean_line, clean_value

Verdict = Literal["better", "worse", "same", "changed", "inconclusive"]

Key = tuple[str, str, str, str, str]
"""Sequence, codec, setting, evaluator, metric."""

SIGNIFICANCE: Final = 0.01
"""Two-sided level; five repeats against five can reach 0.008."""

TIME_TOLERANCE: Final = 0.05
"""Relative change of a median time up to which it counts as unchanged."""

LEAST_CHANGE_MS: Final = 0.01
"""Milliseconds by which a median time must move; less depends on the memory layout of the process."""

LEAST_REPEATS: Final = 5
_MILLISECONDS: Final = "ms"


@dataclass(frozen=True)
class Comparison:
    """One series before and after."""

    key: Key
    before: float
    """Median over repeats, as `after`."""
    after: float
    change: float
    """Relative if `of_time`, else absolute."""
    verdict: Verdict
    note: str = ""
    """The reason of the verdict, or its p-value."""
    of_time: bool = False

    @property
    def relative(self) -> float:
        """The change as a share of the value before; NaN if that is 0."""
        if self.of_time:
            return self.change
        return self.change / abs(self.before) if self.before else math.nan


def compare(
    before: Snapshot, after: Snapshot, *, metrics: Iterable[str] = (), time_tolerance: float = TIME_TOLERANCE
) -> list[Comparison]:
    """Compare every series of either snapshot, matched by sequence, codec setting, evaluator and metric.

    metrics: patterns (`NAME.*`) of `evaluator.metric` to compare; all if there are none.
    """
    patterns = list(metrics)
    first, second = ({series.key: series for series in snapshot.series} for snapshot in (before, after))
    same_machine = bool(before.machines) and set(before.machines) == set(after.machines)
    keys = dict.fromkeys([*first, *second])

    def related_key(key: Key, what: Literal["confirmed_by", "in_units_of"]) -> Key:
        """The key of the series that a series' metric names, from whichever snapshot knows it."""
        known = [getattr(series[key], what) for series in (second, first) if key in series]
        return (*key[:4], next(filter(None, known), ""))

    yardsticks = {unit for key in keys if (unit := related_key(key, "in_units_of"))[4]}

    def judge(key: Key) -> Comparison:
        old, new = first.get(key), second.get(key)
        if old is None or new is None:
            missing = "not in the first run" if old is None else "not in the second run"
            return Comparison(key, math.nan, math.nan, math.nan, "inconclusive", missing)
        unit = related_key(key, "in_units_of")
        scaled = [_scale(series, known.get(unit)) for series, known in ((old, first), (new, second))]
        return _compare_series(old, new, scaled[0], scaled[1], same_machine, time_tolerance)

    comparisons = []
    for key in keys:
        name = f"{key[3]}.{key[4]}"
        if key in yardsticks or (patterns and not any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)):
            continue
        witness = related_key(key, "confirmed_by")
        comparison = judge(key)
        if witness in first and witness in second:
            comparison = _confirm(comparison, judge(witness))
        comparisons.append(comparison)
    return comparisons


def _confirm(claim: Comparison, witness: Comparison) -> Comparison:
    """Withdraw the verdict on a change that the confirming metric does not share: other programs may have caused it."""
    if claim.verdict not in ("better", "worse") or claim.verdict == witness.verdict:
        return claim
    note = f"{witness.key[4]}: {witness.verdict} ({witness.change:+.1%}); other programs may have used the rest"
    return replace(claim, verdict="inconclusive", note=note)


def _scale(series: Series, yardstick: Series | None) -> np.ndarray:
    """Divide times by the yardstick timed in the same repeats; other values stay."""
    values = np.array(series.values, dtype=np.float64)
    if series.repeatable or yardstick is None or len(yardstick.values) != len(values):
        return values
    factor = np.array(yardstick.values)
    scaled: np.ndarray = values * factor if series.better == "higher" else values / factor
    return scaled


def _compare_series(
    old: Series, new: Series, before: np.ndarray, after: np.ndarray, same_machine: bool, tolerance: float
) -> Comparison:
    shown = (_middle(old.values), _middle(new.values))
    if old.fingerprint != new.fingerprint:
        return Comparison(old.key, *shown, math.nan, "inconclusive", "the sequences have different frames")
    if (old.status == "ok") != (new.status == "ok"):
        verdict: Verdict = "better" if new.status == "ok" else "worse"
        worse = new if new.status != "ok" else old
        return Comparison(old.key, *shown, math.nan, verdict, f"{worse.status}: {worse.reason}")
    if old.repeatable:
        return _compare_exactly(old, new, shown)
    return replace(_compare_times(old, new.unit, before, after, shown, same_machine, tolerance), of_time=True)


def _compare_exactly(old: Series, new: Series, shown: tuple[float, float]) -> Comparison:
    pairs = list(zip(old.values, new.values, strict=False))
    if len(old.values) == len(new.values) and all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs):
        return Comparison(old.key, *shown, 0.0, "same")
    change = shown[1] - shown[0]
    if math.isnan(change) or old.better == "neither":
        return Comparison(old.key, *shown, change, "changed")
    if change == 0.0:
        return Comparison(old.key, *shown, change, "changed", "the medians are equal, single repeats are not")
    return Comparison(old.key, *shown, change, "better" if (change > 0) == (old.better == "higher") else "worse")


def _compare_times(
    old: Series, new_unit: str, before: np.ndarray, after: np.ndarray, shown: tuple[float, float], same_machine: bool,
    tolerance: float,
) -> Comparison:  # fmt: skip
    before, after = before[~np.isnan(before)], after[~np.isnan(after)]
    if np.array_equal(before, after):
        return Comparison(old.key, *shown, 0.0, "same", "all times are equal, as in copies of one run")
    few = min(len(before), len(after))
    if few == 0 or (before <= 0).any() or (after <= 0).any():
        return Comparison(old.key, *shown, math.nan, "inconclusive", "one side has no times")
    change = float(np.median(after) / np.median(before) - 1.0)
    if few < LEAST_REPEATS:
        note = f"{few} repeats; at least {LEAST_REPEATS} are needed"
        return Comparison(old.key, *shown, change, "inconclusive", note)

    chance = float(scipy.stats.mannwhitneyu(before, after, method="exact").pvalue)
    note = f"p = {chance:.3f} over {len(before)} and {len(after)} repeats"
    if not same_machine:
        return Comparison(old.key, *shown, change, "inconclusive", f"another machine; {note}")
    too_short = _MILLISECONDS in (old.unit, new_unit) and abs(change) * shown[0] < LEAST_CHANGE_MS
    if abs(change) <= tolerance or too_short:
        return Comparison(old.key, *shown, change, "same", note)
    if chance > SIGNIFICANCE:
        return Comparison(old.key, *shown, change, "inconclusive", note)
    slower = (change > 0) == (old.better == "lower")
    return Comparison(old.key, *shown, change, "worse" if slower else "better", note)


def _middle(values: tuple[float, ...]) -> float:
    present = [value for value in values if not math.isnan(value)]
    return float(np.median(present)) if present else math.nan


FORMAT: Final = 1


@dataclass(frozen=True)
class Series:
    """One metric of one sequence, codec setting and evaluator: a value for each repeat, in order."""

    sequence: str
    codec: str
    setting: str
    evaluator: str
    metric: str
    better: str
    repeatable: bool
    """Whether equal code gives equal values."""
    values: tuple[float, ...]
    """Of per-frame metrics the first declared aggregate over frames."""
    status: str
    """Of the first repeat that is not `ok`, as the reason."""
    reason: str
    fingerprint: str
    """Of the sequence."""
    unit: str = ""
    """As declared, as the next two; empty in baseline files of earlier versions."""
    confirmed_by: str = ""
    in_units_of: str = ""

    @property
    def key(self) -> tuple[str, str, str, str, str]:
        return self.sequence, self.codec, self.setting, self.evaluator, self.metric


@dataclass(frozen=True)
class Snapshot:
    """All series of a run and the machines that computed them."""

    name: str
    machines: tuple[str, ...]
    series: tuple[Series, ...]


_SERIES: Final = TypeAdapter(Series)
_SNAPSHOT: Final = TypeAdapter(Snapshot)


def snapshot_of(run: RunResult) -> Snapshot:
    """The series of a run; a metric of a part (`encode.dct`) is a series of its own."""
    cells: dict[tuple[str, str, str, str], list[CellResult]] = defaultdict(list)
    for result in run.results:
        cell = result.cell
        cells[cell.sequence.name, cell.codec.name, cell.codec.label, cell.evaluator.title].append(result)
    series = tuple(series for members in cells.values() for series in _series(members))
    return Snapshot(run.plan.name, tuple(sorted(map(_machine, run.environments.values()))), series)


def _series(members: list[CellResult]) -> list[Series]:
    members = sorted(members, key=lambda result: result.cell.repeat)
    bad = next((result for result in members if result.status != "ok"), None)
    cell = members[0].cell
    values: dict[str, list[float]] = defaultdict(list)
    metrics = {name: metric for result in members for name, metric in result.metrics.items()}
    for result in members:
        for (name, stage, how), value in result.summaries.items():
            if name in metrics and how == metrics[name].aggregates[0]:
                values[f"{name}.{stage}" if stage else name].append(value)
        for measured in result.measurements:
            name = f"{measured.metric}.{measured.stage}" if measured.stage else measured.metric
            values[name].append(measured.value)
    if not values:
        values["status"] = []
    series = []
    for name, numbers in values.items():
        metric_name, _, stage = name.partition(".")
        metric = metrics.get(metric_name) or Metric(metric_name, "", "neither", "")
        confirmed_by = f"{metric.confirmed_by}.{stage}" if metric.confirmed_by and stage else metric.confirmed_by
        series.append(
            Series(
                cell.sequence.name, cell.codec.name, cell.codec.label, cell.evaluator.title, name,
                metric.better, metric.repeatable, tuple(numbers),
                bad.status if bad else "ok", bad.reason if bad else "", cell.sequence.fingerprint,
                metric.unit, confirmed_by, metric.in_units_of,
            )
        )  # fmt: skip
    return series


def _machine(environment: dict[str, Any]) -> str:
    machine = environment.get("machine", {})
    return f"{machine.get('cpu')}, {machine.get('cores')} cores, {environment.get('volatile', {}).get('host')}"


def write_snapshot(snapshot: Snapshot, path: Path) -> None:
    """Write a snapshot as JSON, one line a series, so that version control shows changes."""
    lines = [
        json.dumps({**asdict(series), "values": [json_value(value) for value in series.values]})
        for series in snapshot.series
    ]
    head = json.dumps({"format": FORMAT, "name": snapshot.name, "machines": snapshot.machines})
    write_file(path, ("\n".join([head, *lines]) + "\n").encode())


def read_snapshot(path: Path) -> Snapshot:
    """Read the snapshot in a file, or of the run in a folder. Raises StoreError for anything else."""
    if path.is_dir():
        return snapshot_of(open_run(path))
    try:
        head, *lines = path.read_text().splitlines()
        facts = clean_value(json_from_bytes(head))
        if facts["format"] != FORMAT:
            raise ValueError(f"it has format {facts['format']}, this version reads {FORMAT}")
        series = tuple(_read(clean_value(json_from_bytes(line))) for line in lines)
        return _SNAPSHOT.validate_python({"name": facts["name"], "machines": facts["machines"], "series": series})
    except FileNotFoundError:
        raise StoreError(f"{path} is neither a run folder nor a baseline file") from None
    except (ValueError, KeyError, TypeError) as error:
        reason = clean_line(str(error))
        raise StoreError(f"{path} is not a baseline that `codecbench compare --save` wrote: {reason}") from error


def _read(value: dict[str, Any]) -> Series:
    numbers = tuple(float("nan") if number is None else float(number) for number in value["values"])
    return _SERIES.validate_python({**value, "values": numbers})
