"""Tests that a setting passes or fails: by the success rate of its runs, or by a mean against a bound."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Literal

import scipy

from codecbench.core.analysis.evidence import Evidence
from codecbench.core.analysis.run_result import Column
from codecbench.core.analysis.verdicts import CONFIDENCE

Passing = Literal["passes", "fails", "inconclusive"]

PASSES_ABOVE: Final = 0.5
"""A setting passes if its success rate is above this share, with 95 % confidence."""

_MOST_MORE_RUNS: Final = 1000


@dataclass(frozen=True)
class Standing:
    """A setting in a sweep, tested by how many of its runs succeeded."""

    point: str
    rate: float
    successes: int
    runs: int
    label: str = field(default="", compare=False)
    why: str = field(default="", compare=False)
    """The commonest reason of runs that did not succeed."""
    requirement: str = field(default="", compare=False)
    """The numbers that successful runs met."""

    @cached_property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the success rate (Wilson 1927, doi:10.1080/01621459.1927.10502953)."""
        if not self.runs:
            return 0.0, 1.0

        limits = scipy.stats.binomtest(self.successes, self.runs).proportion_ci(method="wilson")
        return float(limits.low), float(limits.high)

    @property
    def verdict(self) -> Passing:
        """Whether the interval lies above PASSES_ABOVE, below it, or on both sides."""
        low, high = self.interval
        return "passes" if low > PASSES_ABOVE else "fails" if high < PASSES_ABOVE else "inconclusive"

    @property
    def more_runs(self) -> int:
        """How many more runs would decide at best, if all of them ended as most have."""
        successful = self.successes >= PASSES_ABOVE * self.runs
        return next(
            more
            for more in range(_MOST_MORE_RUNS)
            if Standing("", 0.0, self.successes + more * successful, self.runs + more).verdict != "inconclusive"
        )

    def __str__(self) -> str:
        share = f"{self.successes}/{self.runs} runs"
        if self.verdict == "passes":
            return f"{share}, at least {100 * self.interval[0]:.0f} % at 95 %"
        if self.verdict == "fails":
            return f"{share}, at most {100 * self.interval[1]:.0f} % at 95 %"
        return f"{share}; at least {self.more_runs} more would decide"


@dataclass(frozen=True)
class Level:
    """A setting in a sweep, tested by the mean of a column over frames or repeats against a bound."""

    point: str
    rate: float
    column: Column
    value: float
    bound: float
    margin: Evidence
    """The distance from the bound, positive on the right side."""
    why: str = ""
    """Why it cannot be judged; empty if it can."""
    beside: tuple[Column, float] | None = None
    """The column that is shown with this one, and its mean."""

    @property
    def label(self) -> str:
        return self.column.label

    @property
    def beside_words(self) -> str:
        """` (mean error 2.13 mm)`; empty without such a column."""
        if self.beside is None:
            return ""
        column, value = self.beside
        return f" ({column.label} {column.factor * value:.3g} {column.unit})"

    @property
    def verdict(self) -> Passing:
        """Whether the 95 % interval of the margin lies above 0, below it, or on both sides."""
        reach = self.margin.reach(CONFIDENCE)
        if self.why or not abs(self.margin.mean) > reach:
            return "inconclusive"
        return "passes" if self.margin.mean > 0.0 else "fails"

    def __str__(self) -> str:
        """`0.914 ± 0.008, ≥ 0.9 required`, in the displayed unit."""
        unit = "" if self.column.unit in ("", "1") else f" {self.column.unit}"
        few = "" if self.reach < math.inf else ", too few samples for an interval"
        sure = f" ± {self.reach:.2g}" if 0.0 < self.reach < math.inf else ""
        return f"{self.column.factor * self.value:.3g}{unit}{sure}{few}{self.beside_words}, {self.requirement} required"

    @property
    def reach(self) -> float:
        """Half the width of the 95 % interval, in the displayed unit; infinite for too few samples."""
        return abs(self.column.factor) * self.margin.reach(CONFIDENCE)

    @property
    def requirement(self) -> str:
        unit = "" if self.column.unit in ("", "1") else f" {self.column.unit}"
        sign = "≥" if self.column.better == "higher" else "≤"
        return f"{sign} {self.column.factor * self.bound:.3g}{unit}"


@dataclass(frozen=True)
class Joint:
    """A setting in a sweep that has to pass several tests."""

    tests: Mapping[str, Standing | Level | Joint]
    """By the name of a column or of a sequence."""

    @property
    def first(self) -> Standing | Level | Joint:
        return next(iter(self.tests.values()))

    @property
    def point(self) -> str:
        return self.first.point

    @property
    def rate(self) -> float:
        return self.first.rate

    @property
    def verdict(self) -> Passing:
        """`fails` if one test does, `passes` if all do."""
        verdicts = {test.verdict for test in self.tests.values()}
        return "fails" if "fails" in verdicts else "inconclusive" if "inconclusive" in verdicts else "passes"

    @property
    def requirement(self) -> str:
        return "; ".join(f"{name} {test.requirement}" for name, test in self.tests.items())

    @property
    def why(self) -> str:
        return ""

    def __str__(self) -> str:
        """The tests that decide the verdict, in words."""
        deciding = [(name, test) for name, test in self.tests.items() if test.verdict == self.verdict]
        return "; ".join(f"{name} {describe(test)}" for name, test in deciding)


Test = Standing | Level | Joint


def describe(test: Test) -> str:
    """Describe a test and its reason: `1/4 runs, at most 70 % at 95 %: ATE 31 mm, over 19.8 mm`."""
    return f"{test}: {test.why}" if test.why else str(test)


def parts(test: Test) -> Iterator[Standing | Level]:
    """Yield the single tests of a setting."""
    if isinstance(test, Joint):
        for part in test.tests.values():
            yield from parts(part)
    else:
        yield test
