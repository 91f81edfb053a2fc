"""How hard a codec may compress before a task fails, as far as so many runs can tell."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile
from typing import Final, Literal, TypeVar

import numpy as np

from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.run_result import Key, RunResult
from codecbench.core.analysis.verdicts import Place, Points, SequenceCurve, values_of_repeats

Holding = Literal["holds", "fails", "cannot tell"]

HOLDS_ABOVE: Final = 0.5
"""A setting holds where more than this share of all runs that there could be would succeed."""

POOLED: Final = ""
"""Stands for all sequences together."""

_MOST_MORE_RUNS: Final = 1000

T = TypeVar("T")
U = TypeVar("U")


@dataclass(frozen=True)
class Standing:
    """A setting in a sweep: how many of its runs succeeded, and what that says of all that there could be."""

    point: str
    rate: float
    successes: int
    runs: int

    @cached_property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the success rate (Wilson 1927, doi:10.1080/01621459.1927.10502953)."""
        from scipy.stats import binomtest  # loads for half a second, and few runs have a task

        found = binomtest(self.successes, self.runs).proportion_ci(method="wilson")
        return float(found.low), float(found.high)

    @property
    def verdict(self) -> Holding:
        """Whether the interval lies above HOLDS_ABOVE, below it, or on both sides."""
        low, high = self.interval
        return "holds" if low > HOLDS_ABOVE else "fails" if high < HOLDS_ABOVE else "cannot tell"

    @property
    def more_runs(self) -> int:
        """How many more runs would tell, if all of them ended as most have; at best, that is."""
        successful = self.successes >= HOLDS_ABOVE * self.runs
        return next(
            more
            for more in range(_MOST_MORE_RUNS)
            if Standing("", 0.0, self.successes + more * successful, self.runs + more).verdict != "cannot tell"
        )

    def __str__(self) -> str:
        share = f"{self.successes}/{self.runs} runs"
        if self.verdict == "holds":
            return f"{share}, at least {100 * self.interval[0]:.0f} % at 95 %"
        if self.verdict == "fails":
            return f"{share}, at most {100 * self.interval[1]:.0f} % at 95 %"
        return f"{share}; at least {self.more_runs} more would tell"


@dataclass(frozen=True)
class Limit:
    """A sweep and where it ends. settings: from the most rate to the least. reason: why nothing can be said."""

    settings: tuple[Standing, ...] = ()
    reason: str = ""

    @property
    def lowest(self) -> Standing | None:
        """The setting of least rate that holds, with every setting of more rate holding too."""
        held = list(takewhile(lambda setting: setting.verdict == "holds", self.settings))
        return held[-1] if held else None

    @property
    def rate(self) -> float:
        """Of the lowest setting that holds; infinite where none does."""
        return float("inf") if self.lowest is None else self.lowest.rate

    @property
    def next(self) -> Standing | None:
        """The first setting that is not known to hold; None where all hold."""
        return next((setting for setting in self.settings if setting.verdict != "holds"), None)

    @property
    def out_of_order(self) -> tuple[Standing, ...]:
        """Settings that fail though one of less rate holds."""
        holding = [place for place, setting in enumerate(self.settings) if setting.verdict == "holds"]
        return tuple(setting for setting in self.settings[: max(holding, default=0)] if setting.verdict == "fails")

    def after_words(self) -> str:
        """What comes after the limit, and whether that is out of order."""
        after = self.next
        if after is None:
            return "never failed here"
        name = after.point or "its setting"
        if after.verdict == "cannot tell":
            return f"cannot tell of {name} ({after})"
        words = f"{name} fails ({after})"
        if after in self.out_of_order:
            again = [
                setting.point for setting in self.settings if setting.verdict == "holds" and setting.rate < after.rate
            ]
            words += f"; out of order, for {', '.join(again)} below it holds"
        return words


def limits(run: RunResult, columns: Sequence[Column]) -> dict[SequenceCurve, Limit]:
    """The limit of each curve on each sequence, for columns of role `success`: runs count that succeed in all.

    With several sequences there is a limit over all of them too, under POOLED, of the runs of all and the mean rates.
    """
    rates, successes = run.rates, together([values_of_repeats(run, column, failed=0.0) for column in columns])
    if len({row[0] for row in successes}) > 1:
        successes |= _pooled(successes, lambda lists: [value for values in lists for value in values])
        rates = rates | pooled_rates(run)
    if run.rate is None:
        reason = "no rate was measured; add an evaluator with a headline of role rate"
        return {
            (sequence, run.curves[codec, label].curve): Limit(reason=reason) for sequence, codec, label in successes
        }
    return limits_of(rates, successes, run.curves)


def pooled_rates(run: RunResult) -> dict[Key, float]:
    """The mean rate over sequences of each setting, by its row of the sequence POOLED; NaN where one is not known."""
    return _pooled(run.rates, lambda rates: float(np.mean(rates)))


def _pooled(rows: Mapping[Key, T], merged: Callable[[list[T]], U]) -> dict[Key, U]:
    settings: dict[tuple[str, str], list[T]] = defaultdict(list)
    for (_, codec, label), value in rows.items():
        settings[codec, label].append(value)
    return {(POOLED, codec, label): merged(values) for (codec, label), values in settings.items()}


def together(columns: Sequence[Mapping[Key, Mapping[Place, float]]]) -> dict[Key, list[float]]:
    """The least of several columns' values at each place of a row, NaN where a column lacks it.

    Places of which no row of a sequence has a value, as where the baseline fails too, say nothing and are left out.
    """
    least: dict[Key, dict[Place, float]] = {}
    judged: set[tuple[str, Place]] = set()
    for row in dict.fromkeys(row for column in columns for row in column):
        values = [column.get(row, {}) for column in columns]
        places = sorted({place for column in values for place in column})
        least[row] = {place: float(np.min([column.get(place, np.nan) for column in values])) for place in places}
        judged |= {(row[0], place) for place, value in least[row].items() if not np.isnan(value)}
    return {row: [value for place, value in found.items() if (row[0], place) in judged] for row, found in least.items()}


def limits_of(
    rates: Mapping[Key, float], successes: Mapping[Key, Sequence[float]], points: Points
) -> dict[SequenceCurve, Limit]:
    """The limit of each curve by (sequence, curve), with a reason where there is none.

    successes: a value a run, 1 where it succeeded; a value that is missing counts as a run without success. A curve
    with a setting whose rate is not known has no limit, because nobody can say where that setting stands in the sweep.
    """
    curves: dict[SequenceCurve, list[Standing]] = defaultdict(list)
    for (sequence, codec, setting), values in successes.items():
        point = points[codec, setting]
        held = sum(value == 1.0 for value in values)
        rate = rates.get((sequence, codec, setting), np.nan)
        curves[sequence, point.curve].append(Standing(point.point, rate, held, len(values)))
    return {key: _limit(members) for key, members in curves.items()}


def _limit(members: list[Standing]) -> Limit:
    if unknown := [member.point or "its setting" for member in members if np.isnan(member.rate)]:
        return Limit(reason=f"no rate is known of {', '.join(unknown)}")
    if not all(member.runs for member in members):
        return Limit(reason="its runs cannot be judged here")
    return Limit(tuple(sorted(members, key=lambda member: -member.rate)))
