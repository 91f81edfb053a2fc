"""The statistical power of a run: the smallest difference that it can show, and what would decide the other pairs."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal

import numpy as np
import scipy

from codecbench.core.analysis.curve_values import SMALLEST
from codecbench.core.analysis.evidence import FEWEST_FRAMES, POWER, Evidence, student_quantile
from codecbench.core.analysis.limits import limits
from codecbench.core.analysis.passing import Standing, parts
from codecbench.core.analysis.ranking import SIGNIFICANCE, Gap, Ranking, holm, rankings
from codecbench.core.analysis.run_result import Column, RunResult

_MOST_TIMES: Final = 100.0
"""Greatest factor by which a run may grow to decide a pair; longer extrapolation is not justified."""
Kind = Literal["decided", "equal", "small", "settings", "samples", "sequences", "beyond"]
"""The kinds of remedies.

decided: none is needed. equal: none, as the pair is equal within the smallest difference worth knowing. small: none, as
the difference and all errors are below that. settings: more settings in a gap. samples: more frames, repeats or
sequences. sequences: more sequences, because those there are disagree. beyond: a hundredfold of the samples would not
do."""


@dataclass(frozen=True)
class Remedy:
    """What would decide a pair of curves."""

    kind: Kind
    more: int | None = None
    """About how many more samples; None if unknown."""
    gap: Gap | None = None
    """Where more settings are needed."""


@dataclass(frozen=True)
class PairPower:
    """Two curves by a column on a sequence, or over all (POOLED), and the power of their test."""

    column: Column
    sequence: str
    first: str
    second: str
    evidence: Evidence
    p_value: float
    """Adjusted for all pairs of the ranking (Holm)."""
    level: float
    """Significance level of the least p-value of the ranking."""
    units: int
    """Number of samples."""
    of: tuple[str, ...]
    """What the samples are: frames, repeats, or sequences."""
    power: float
    gap: Gap | None = None
    """As in the ranking."""
    disputed: bool = False
    """As in the ranking."""

    @property
    def difference(self) -> float:
        """Log of the second curve's rate over the first's for the same quality."""
        return self.evidence.mean

    @property
    def stands(self) -> bool:
        """Whether the difference is significant."""
        return self.p_value < SIGNIFICANCE

    @property
    def remedy(self) -> Remedy:
        """What would decide the pair."""
        size, evidence = abs(self.difference), self.evidence
        if self.stands:
            return Remedy("decided")
        if size + evidence.reach(1.0 - self.level) < SMALLEST:
            return Remedy("equal")
        if math.isnan(evidence.variance):
            few = self.of == ("frames",) and self.units < FEWEST_FRAMES
            return Remedy("samples", FEWEST_FRAMES - self.units if few else None)
        if not evidence.at_least and max(size, evidence.doubt, math.sqrt(evidence.variance)) < SMALLEST:
            return Remedy("small")
        if self.gap is not None and (evidence.doubt >= abs(size - SMALLEST) or self.more_units is None):
            return Remedy("settings", gap=self.gap)
        if self.disputed:
            return Remedy("sequences")
        return Remedy("beyond") if self.more_units is None else Remedy("samples", self.more_units)

    @cached_property
    def smallest(self) -> float:
        """The difference that is significant in the share `power` of cases; NaN if there is none."""
        return self._smallest_with(1.0)

    @cached_property
    def more_units(self) -> int | None:
        """How many more samples would decide, if they go on as they did.

        0 if the pair is decided, None if a hundredfold would not decide it.
        """
        if self.stands:
            return 0
        most = round(self.units * (_MOST_TIMES - 1.0))
        return bisect_left(range(most + 1), True, lo=1, key=self._is_enough) if self._is_enough(most) else None

    def _is_enough(self, more: int) -> bool:
        return self._smallest_with(1.0 + more / self.units) <= abs(self.difference)

    def _smallest_with(self, factor: float) -> float:
        """The smallest detectable difference with `factor` times as many samples."""
        more = scale_evidence(self.evidence, factor, "frames" in self.of)
        return (0.0 if more.at_least else SMALLEST + more.doubt) + smallest_difference(more, self.level, self.power)


@dataclass(frozen=True)
class LimitPower:
    """The runs of a setting, and the power of their test."""

    columns: tuple[Column, ...]
    sequence: str
    curve: str
    standing: Standing
    power: float

    @cached_property
    def detectable_rate(self) -> float:
        """The success rate from which runs show a pass in the share `power` of cases; NaN if so few never do."""

        runs = self.standing.runs
        least = next((n for n in range(runs + 1) if Standing("", 0.0, n, runs).verdict == "passes"), None)
        return math.nan if least is None else float(scipy.special.betaincinv(least, runs - least + 1, self.power))

    @property
    def more_runs(self) -> int:
        """How many more runs would decide at best; 0 if the verdict stands."""
        return self.standing.more_runs


def smallest_difference(evidence: Evidence, level: float, power: float) -> float:
    """The difference that is significant at a two-sided level in the share `power` of cases; NaN if there is none.

    By Student's t: the standard error times the sum of two quantiles.
    """
    if not (evidence.freedom > 0 and evidence.variance > 0.0):
        return math.nan
    reach = student_quantile(1.0 - level / 2.0, evidence.freedom) + student_quantile(power, evidence.freedom)
    return reach * math.sqrt(evidence.variance)


def scale_evidence(evidence: Evidence, factor: float, frames: bool = False) -> Evidence:
    """Extrapolate evidence to `factor` times as many repeats or frames like those there are.

    The degrees of freedom of frames stay: they are those of the slowest changes.
    """
    freedom = evidence.freedom if frames else (evidence.freedom + 1.0) * factor - 1.0
    return replace(evidence, variance=evidence.variance / factor, freedom=freedom)


def pair_powers(run: RunResult, power: float = POWER) -> list[PairPower]:
    """The power of every pair of curves in every ranking of a run; power: between 0 and 1."""
    return [pair for ranking in rankings(run) for pair in powers_of(ranking, power)]


def powers_of(ranking: Ranking, power: float = POWER) -> Iterator[PairPower]:
    """Yield the power of every pair of curves in a ranking; power: between 0 and 1."""
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
    """The power of every setting's runs by columns of role `success`; a run has to succeed in all."""
    return [
        LimitPower(tuple(columns), sequence, curve, standing, power)
        for (sequence, curve), limit in limits(run, columns).items()
        for setting in limit.settings
        if isinstance(standing := next(parts(setting)), Standing)
    ]
