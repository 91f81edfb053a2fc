"""Better, worse, same, or cannot tell.

Values that repeat (sizes, quality, operation counts) are compared exactly. Times are divided by the yardstick that
was timed between them, which takes the machine's own ups and downs out, and then tested over repeats: a change
counts where the Mann-Whitney test over repeats finds it beyond chance and the median moved by more than a
tolerance. Source of the test: Mann and Whitney 1947, doi:10.1214/aoms/1177730491, exact distribution. Time by the
clock on the wall also holds what other programs took, for a whole run at a time, which no test within that run can see:
its verdict stands only where processor time moved the same way.
"""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np
from scipy.stats import mannwhitneyu

from codecbench.core.results.comparison.snapshot import Series, Snapshot

Verdict = Literal["better", "worse", "same", "changed", "cannot tell"]

Key = tuple[str, str, str, str, str]
"""Sequence, codec, setting, evaluator, metric."""

SIGNIFICANCE: Final = 0.01
"""Two-sided; five repeats against five can reach 0.008."""

TIME_TOLERANCE: Final = 0.05
"""Relative change of a median time up to which it counts as unchanged."""

LEAST_CHANGE_MS: Final = 0.01
"""Milliseconds by which a median time must move: less depends on where the memory of a process happens to lie."""

LEAST_REPEATS: Final = 5
YARDSTICK: Final = "yardstick_ms"
ON_THE_WALL: Final = ("_wall_ms", "_mpix_per_s")
"""Endings of metrics that are, or come from, time by the clock on the wall; `_cpu_ms` is beside them."""


@dataclass(frozen=True)
class Comparison:
    """One series before and after. change: relative for times, absolute otherwise. note: why, or how sure."""

    key: Key
    before: float
    after: float
    change: float
    verdict: Verdict
    note: str = ""


def compare(
    before: Snapshot, after: Snapshot, *, metrics: Iterable[str] = (), time_tolerance: float = TIME_TOLERANCE
) -> list[Comparison]:
    """Every series of either snapshot, matched by sequence, codec setting, evaluator and metric.

    metrics: patterns (`quality.psnr*`) of `evaluator.metric` to look at; all where none is given.
    """
    patterns = list(metrics)
    first, second = ({one.key: one for one in snapshot.series} for snapshot in (before, after))
    yardsticks = (_yardsticks(before), _yardsticks(after))
    same_machine = bool(before.machines) and set(before.machines) == set(after.machines)

    def judged(key: Key) -> Comparison:
        old, new = first.get(key), second.get(key)
        if old is None or new is None:
            missing = "not in the first run" if old is None else "not in the second run"
            return Comparison(key, math.nan, math.nan, math.nan, "cannot tell", missing)
        scaled = [_scaled(one, known) for one, known in zip((old, new), yardsticks, strict=True)]
        return _compared(old, new, scaled[0], scaled[1], same_machine, time_tolerance)

    found = []
    for key in dict.fromkeys([*first, *second]):
        name = f"{key[3]}.{key[4]}"
        if key[4] == YARDSTICK or (patterns and not any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)):
            continue
        processor = _processor_time(key)
        one = judged(key)
        found.append(_supported(one, judged(processor)) if processor in first and processor in second else one)
    return found


def _processor_time(key: Key) -> Key | None:
    """The processor time beside a time by the clock on the wall, or None for what is no such time."""
    for ending in ON_THE_WALL:
        if key[4].endswith(ending):
            return (*key[:4], key[4].removesuffix(ending) + "_cpu_ms")
    return None


def _supported(wall: Comparison, processor: Comparison) -> Comparison:
    if wall.verdict not in ("better", "worse") or wall.verdict == processor.verdict:
        return wall
    note = f"processor time: {processor.verdict} ({processor.change:+.1%}); other programs may have taken the rest"
    return replace(wall, verdict="cannot tell", note=note)


def _yardsticks(snapshot: Snapshot) -> dict[tuple[str, str, str, str], tuple[float, ...]]:
    return {one.key[:4]: one.values for one in snapshot.series if one.metric == YARDSTICK}


def _scaled(series: Series, yardsticks: dict[tuple[str, str, str, str], tuple[float, ...]]) -> np.ndarray:
    """The values in units of the yardstick timed in the same repeats, where there is one and they are times."""
    values = np.array(series.values, dtype=np.float64)
    unit = yardsticks.get(series.key[:4])
    if series.repeatable or unit is None or len(unit) != len(values):
        return values
    factor = np.array(unit)
    scaled: np.ndarray = values * factor if series.better == "higher" else values / factor
    return scaled


def _compared(
    old: Series, new: Series, before: np.ndarray, after: np.ndarray, same_machine: bool, tolerance: float
) -> Comparison:
    shown = (_middle(old.values), _middle(new.values))
    if old.fingerprint != new.fingerprint:
        return Comparison(old.key, *shown, math.nan, "cannot tell", "the sequences have other frames")
    if (old.status == "ok") != (new.status == "ok"):
        verdict: Verdict = "better" if new.status == "ok" else "worse"
        worse = new if new.status != "ok" else old
        return Comparison(old.key, *shown, math.nan, verdict, f"{worse.status}: {worse.reason}")
    if old.repeatable:
        return _exact(old, new, shown)
    return _timed(old, before, after, shown, same_machine, tolerance)


def _exact(old: Series, new: Series, shown: tuple[float, float]) -> Comparison:
    pairs = list(zip(old.values, new.values, strict=False))
    if len(old.values) == len(new.values) and all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs):
        return Comparison(old.key, *shown, 0.0, "same")
    change = shown[1] - shown[0]
    if math.isnan(change) or old.better == "neither":
        return Comparison(old.key, *shown, change, "changed")
    if change == 0.0:
        return Comparison(old.key, *shown, change, "changed", "the median is the same, single repeats are not")
    return Comparison(old.key, *shown, change, "better" if (change > 0) == (old.better == "higher") else "worse")


def _timed(
    old: Series, before: np.ndarray, after: np.ndarray, shown: tuple[float, float], same_machine: bool, tolerance: float
) -> Comparison:
    before, after = before[~np.isnan(before)], after[~np.isnan(after)]
    few = min(len(before), len(after))
    if few == 0 or (before <= 0).any() or (after <= 0).any():
        return Comparison(old.key, *shown, math.nan, "cannot tell", "no times on one side")
    change = float(np.median(after) / np.median(before) - 1.0)
    if few < LEAST_REPEATS:
        return Comparison(old.key, *shown, change, "cannot tell", f"{few} repeats; at least {LEAST_REPEATS} are needed")
    chance = float(mannwhitneyu(before, after, method="exact").pvalue)
    note = f"p = {chance:.3f} over {len(before)} and {len(after)} repeats"
    if not same_machine:
        return Comparison(old.key, *shown, change, "cannot tell", f"another machine; {note}")
    too_short = old.metric.endswith("_ms") and abs(change) * shown[0] < LEAST_CHANGE_MS
    if abs(change) <= tolerance or too_short:
        return Comparison(old.key, *shown, change, "same", note)
    if chance > SIGNIFICANCE:
        return Comparison(old.key, *shown, change, "cannot tell", note)
    slower = (change > 0) == (old.better == "lower")
    return Comparison(old.key, *shown, change, "worse" if slower else "better", note)


def _middle(values: tuple[float, ...]) -> float:
    present = [value for value in values if not math.isnan(value)]
    return float(np.median(present)) if present else math.nan
