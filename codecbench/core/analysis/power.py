"""What a run could decide: the smallest difference that it would have shown, and what would decide the others."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal

import numpy as np

from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.curve_values import SMALLEST
from codecbench.core.analysis.evidence import FEWEST_FRAMES, POWER, Evidence, student_quantile
from codecbench.core.analysis.limits import limits
from codecbench.core.analysis.passing import Standing, parts
from codecbench.core.analysis.ranking import SIGNIFICANCE, Gap, Ranking, holm, rankings
from codecbench.core.analysis.run_result import RunResult

_MOST_TIMES: Final = 100.0
"""A run may grow by this factor to decide a pair; how frames go on for longer is not known."""
Kind = Literal["decided", "equal", "small", "settings", "samples", "sequences", "beyond"]


@dataclass(frozen=True)
class Remedy:
    """What would decide a pair of curves.

    kind: nothing, because the pair is `decided`, `equal` within the smallest difference worth knowing at the level of
    the ranking, or `small`, as the difference and all errors are below that; more `settings`, in the `gap`; more
    `samples`, which are frames, repeats or sequences, about `more` of them if that is known; more `sequences`, because
    those there are disagree; or `beyond`: not a hundredfold of the samples.
    """

    kind: Kind
    more: int | None = None
    gap: Gap | None = None


@dataclass(frozen=True)
class PairPower:
    """Two curves by a column on a sequence, or over all (POOLED), and what so many frames or repeats could show.

    difference: log of how many times the rate of the first the second takes for the same quality. smallest: the
    difference that would be found, at the level of the ranking, in the share `power` of cases; NaN where none could be.
    p_value: adjusted for all pairs of the ranking (Holm). level: below which the least p-value of the ranking must be.
    units: how many samples there are, which are `of`: frames, repeats, or sequences where these are the samples. gap,
    disputed: as in the ranking.
    """

    column: Column
    sequence: str
    first: str
    second: str
    evidence: Evidence
    p_value: float
    level: float
    units: int
    of: tuple[str, ...]
    power: float
    gap: Gap | None = None
    disputed: bool = False

    @property
    def difference(self) -> float:
        return self.evidence.mean

    @property
    def stands(self) -> bool:
        """Whether the ranking puts one before the other."""
        return self.p_value < SIGNIFICANCE

    @property
    def remedy(self) -> Remedy:
        """What would decide the pair."""
        size, found = abs(self.difference), self.evidence
        if self.stands:
            return Remedy("decided")
        if size + found.reach(1.0 - self.level) < SMALLEST:
            return Remedy("equal")
        if math.isnan(found.variance):
            few = self.of == ("frames",) and self.units < FEWEST_FRAMES
            return Remedy("samples", FEWEST_FRAMES - self.units if few else None)
        if not found.at_least and max(size, found.doubt, math.sqrt(found.variance)) < SMALLEST:
            return Remedy("small")
        if self.gap is not None and (found.doubt >= abs(size - SMALLEST) or self.more_units is None):
            return Remedy("settings", gap=self.gap)
        if self.disputed:
            return Remedy("sequences")
        return Remedy("beyond") if self.more_units is None else Remedy("samples", self.more_units)

    @cached_property
    def smallest(self) -> float:
        return self._shown_by(1.0)

    @cached_property
    def more_units(self) -> int | None:
        """How many more samples would decide, if they go on as they did; None if a hundredfold would not.

        0 where the verdict stands.
        """
        if self.stands:
            return 0
        most = round(self.units * (_MOST_TIMES - 1.0))
        return bisect_left(range(most + 1), True, lo=1, key=self._decided_by) if self._decided_by(most) else None

    def _decided_by(self, more: int) -> bool:
        return self._shown_by(1.0 + more / self.units) <= abs(self.difference)

    def _shown_by(self, factor: float) -> float:
        """The smallest difference that so many times as many frames or repeats would show."""
        more = times(self.evidence, factor, "frames" in self.of)
        return (0.0 if more.at_least else SMALLEST + more.doubt) + smallest_difference(more, self.level, self.power)


@dataclass(frozen=True)
class LimitPower:
    """A setting's runs, and what they could tell. told_from: the success rate from which on so many runs would show, in
    the share `power` of cases, that it passes; NaN where no number of successes among them does.
    """

    columns: tuple[Column, ...]
    sequence: str
    curve: str
    standing: Standing
    power: float

    @cached_property
    def told_from(self) -> float:
        from scipy.special import betaincinv  # as in student_quantile

        runs = self.standing.runs
        least = next((n for n in range(runs + 1) if Standing("", 0.0, n, runs).verdict == "passes"), None)
        return math.nan if least is None else float(betaincinv(least, runs - least + 1, self.power))

    @property
    def more_runs(self) -> int:
        """How many more would tell at best; 0 where the verdict stands."""
        return self.standing.more_runs


def smallest_difference(evidence: Evidence, level: float, power: float) -> float:
    """The difference that is found at a two-sided level in the share `power` of cases; NaN where nothing can be.

    By Student's t: the standard error times the sum of two of its quantiles.
    """
    if not (evidence.freedom > 0 and evidence.variance > 0.0):
        return math.nan
    reach = student_quantile(1.0 - level / 2.0, evidence.freedom) + student_quantile(power, evidence.freedom)
    return reach * math.sqrt(evidence.variance)


def times(evidence: Evidence, factor: float, frames: bool = False) -> Evidence:
    """What `factor` times as many repeats would say, or frames, were they like those there are.

    The degrees of freedom of frames stay: they are those of the slowest changes.
    """
    freedom = evidence.freedom if frames else (evidence.freedom + 1.0) * factor - 1.0
    return replace(evidence, variance=evidence.variance / factor, freedom=freedom)


def pair_powers(run: RunResult, power: float = POWER) -> list[PairPower]:
    """Every pair of curves of every ranking of a run; power: between 0 and 1."""
    return [pair for ranking in rankings(run) for pair in powers_of(ranking, power)]


def powers_of(ranking: Ranking, power: float = POWER) -> Iterator[PairPower]:
    """Every pair of curves of a ranking; power: between 0 and 1."""
    adjusted = holm(np.array([evidence.p_beyond(SMALLEST) for *_, evidence in ranking.pairs]))
    level = SIGNIFICANCE / max(1, len(ranking.pairs))
    units, of = (len(ranking.sequences), ("sequences",)) if ranking.too_few_on else (ranking.units, ranking.of)
    for (first, second, evidence), p_value in zip(ranking.pairs, adjusted, strict=True):
        pair = (first, second)
        yield PairPower(
            ranking.column, ranking.sequence, first, second, evidence, float(p_value), level,
            units, of, power, ranking.gaps.get(pair), pair in ranking.disputed,
        )  # fmt: skip


def limit_powers(run: RunResult, columns: Sequence[Column], power: float = POWER) -> list[LimitPower]:
    """Every setting of every curve, for columns of role `success`: runs count that succeed in all."""
    return [
        LimitPower(tuple(columns), sequence, curve, standing, power)
        for (sequence, curve), limit in limits(run, columns).items()
        for setting in limit.settings
        if isinstance(standing := next(parts(setting)), Standing)
    ]
