"""Whether a setting passes a test: so many runs succeed, or a mean is on the right side of a bound."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Literal

from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.evidence import Evidence
from codecbench.core.analysis.verdicts import CONFIDENCE

Passing = Literal["passes", "fails", "inconclusive"]

PASSES_ABOVE: Final = 0.5
"""A setting passes if more than this share of all runs that there could be would succeed."""

_MOST_MORE_RUNS: Final = 1000


@dataclass(frozen=True)
class Standing:
    """A setting in a sweep: how many of its runs succeeded, and what that says of all that there could be.

    why: the commonest reason of runs that did not succeed. asked: what the others met, in numbers.
    """

    point: str
    rate: float
    successes: int
    runs: int
    label: str = field(default="", compare=False)
    why: str = field(default="", compare=False)
    asked: str = field(default="", compare=False)

    @cached_property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the success rate (Wilson 1927, doi:10.1080/01621459.1927.10502953); all, of no run."""
        if not self.runs:
            return 0.0, 1.0
        from scipy.stats import binomtest  # loads for half a second, and few runs have a task

        found = binomtest(self.successes, self.runs).proportion_ci(method="wilson")
        return float(found.low), float(found.high)

    @property
    def verdict(self) -> Passing:
        """Whether the interval lies above PASSES_ABOVE, below it, or on both sides."""
        low, high = self.interval
        return "passes" if low > PASSES_ABOVE else "fails" if high < PASSES_ABOVE else "inconclusive"

    @property
    def more_runs(self) -> int:
        """How many more runs would tell, if all of them ended as most have; at best, that is."""
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
        return f"{share}; at least {self.more_runs} more would tell"


@dataclass(frozen=True)
class Level:
    """A setting in a sweep: the mean of a column over frames or repeats, and its distance from a bound.

    margin: what is known of that distance, positive on the right side. why: what keeps it from being judged.
    """

    point: str
    rate: float
    column: Column
    value: float
    bound: float
    margin: Evidence
    why: str = ""

    @property
    def label(self) -> str:
        return self.column.label

    @property
    def verdict(self) -> Passing:
        """Whether the 95 % interval of the margin lies above 0, below it, or on both sides."""
        reach = self.margin.reach(CONFIDENCE)
        if self.why or not abs(self.margin.mean) > reach:
            return "inconclusive"
        return "passes" if self.margin.mean > 0.0 else "fails"

    def __str__(self) -> str:
        """`0.914 ± 0.008, ≥ 0.9 asked`, in the unit that people are shown."""
        unit = "" if self.column.unit in ("", "1") else f" {self.column.unit}"
        few = "" if self.reach < math.inf else ", too few to tell"
        sure = f" ± {self.reach:.2g}" if 0.0 < self.reach < math.inf else ""
        return f"{self.column.factor * self.value:.3g}{unit}{sure}{few}, {self.asked} asked"

    @property
    def reach(self) -> float:
        """How far the 95 % interval reaches, in the unit that people are shown; infinite if too few to tell."""
        return abs(self.column.factor) * self.margin.reach(CONFIDENCE)

    @property
    def asked(self) -> str:
        unit = "" if self.column.unit in ("", "1") else f" {self.column.unit}"
        sign = "≥" if self.column.better == "higher" else "≤"
        return f"{sign} {self.column.factor * self.bound:.3g}{unit}"


@dataclass(frozen=True)
class Joint:
    """A setting in a sweep that has to pass several tests, each by its name: a column, or a sequence of several."""

    tests: Mapping[str, Standing | Level | Joint]

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
    def asked(self) -> str:
        return "; ".join(f"{name} {test.asked}" for name, test in self.tests.items())

    @property
    def why(self) -> str:
        return ""

    def __str__(self) -> str:
        """The tests that decide: if it does not pass, those that do not."""
        told = [(name, test) for name, test in self.tests.items() if test.verdict == self.verdict]
        return "; ".join(f"{name} {described(test)}" for name, test in told)


Test = Standing | Level | Joint


def described(test: Test) -> str:
    """A test with the reason of what did not succeed: `1/4 runs, at most 70 % at 95 %: ATE 31 mm, over 19.8 mm`."""
    return f"{test}: {test.why}" if test.why else str(test)


def parts(test: Test) -> Iterator[Standing | Level]:
    """The single tests of a setting."""
    if isinstance(test, Joint):
        for part in test.tests.values():
            yield from parts(part)
    else:
        yield test
