"""A strip for each codec: all settings that were tried over what they spend, which of them pass, and the pick."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import groupby
from typing import Final

from codecbench.core.analysis.passing import Passing, described
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.answers import Answer, Answers
from codecbench.core.report.costs import bit_rate_mbps, coding_ms, times_decide
from codecbench.core.report.tables import three_digits

_MARGIN: Final = 0.05
"""Of the axis that stays free at either end."""
_NARROWEST: Final = 4.0
"""An axis spans this factor at least: settings that are close together are shown close together."""
_MOST_TICKS: Final = 6
_STEPS: Final = ((1,), (1, 3), (1, 2, 5), tuple(range(1, 10)))
"""Where numbers may stand on the axis, times powers of ten; the first that gives three of them is taken."""


@dataclass(frozen=True)
class Mark:
    """A setting of a codec. place: percent of the axis; None if what it spends is not known. words: what was found."""

    setting: str
    verdict: Passing
    words: str
    place: float | None
    is_pick: bool


@dataclass(frozen=True)
class Row:
    """A codec. pick: the setting to take. cost: what it spends, or that there is none. after: the first setting that is
    not known to pass. saved: beside the pick of the anchor. marks: from the most that is spent to the least.
    """

    curve: str
    pick: str
    cost: str
    saved: str
    after: str
    marks: tuple[Mark, ...]

    @property
    def words(self) -> str:
        """What the marks show, for who does not see them: `a, b: passes; c: fails`."""
        groups = groupby(self.marks, key=lambda mark: mark.verdict)
        return "; ".join(f"{', '.join(mark.setting for mark in marks)}: {verdict}" for verdict, marks in groups)


@dataclass(frozen=True)
class Strips:
    """Rows in the order of the answer, above one logarithmic axis in a unit. ticks: percent of the axis, and text."""

    about: str
    unit: str
    ticks: tuple[tuple[float | None, str], ...]
    rows: tuple[Row, ...]


def strips(run: RunResult, found: Answers) -> Strips | None:
    """The strips of an answer; None where no setting was judged."""
    if not found.answers:
        return None
    unit, spent = _spent(run, found)
    axis = _Axis.around(spent.values())
    base, least = _anchor(run, found, spent)

    def cost(value: float) -> str:
        return "" if math.isnan(value) else f"{three_digits(value)} {unit}"

    def saved(curve: str, value: float) -> str:
        if curve == base:
            return "the anchor"
        more = 100.0 * (value / least - 1.0)
        if math.isnan(more):
            return ""
        share = f"{abs(more):.0f} % {'less' if more < 0.0 else 'more'}"
        return f"{share} {'time ' if times_decide(run) else ''}than {base}"

    def row(answer: Answer) -> Row:
        limit, curve = answer.limit, answer.curve
        marks = []
        for test in limit.settings:
            value = spent[curve, test.point]
            setting = test.point or "its setting"
            words = f"{', '.join(filter(None, (setting, cost(value))))}: {test.verdict} ({described(test)})"
            marks.append(Mark(setting, test.verdict, words, axis.place(value), test is limit.lowest))
        after = limit.reason or (limit.after_words() if limit.settings else "no run")
        if limit.lowest is None:
            return Row(curve, "", "passes nowhere" if answer.passes is False else "no pick", "", after, tuple(marks))
        value = spent[curve, limit.lowest.point]
        pick = limit.lowest.point or "its setting"
        return Row(curve, pick, cost(value), saved(curve, value), after, tuple(marks))

    return Strips(found.about, unit, axis.ticks, tuple(row(answer) for answer in found.answers))


def _spent(run: RunResult, found: Answers) -> tuple[str, dict[tuple[str, str], float]]:
    """What each setting spends by curve and point, and the unit: what decides between them, in one unit for all."""
    tests = {(answer.curve, test.point): test for answer in found.answers for test in answer.limit.settings}
    if times_decide(run):
        return "ms", {key: sum(coding_ms(run, found.on, key[0], test)) for key, test in tests.items()}
    mbps = {key: bit_rate_mbps(run, found.on, key[0], test) for key, test in tests.items()}
    if mbps and all(value > 0.0 for value in mbps.values()):
        return "Mbit/s", mbps
    assert run.rate is not None
    return run.rate.unit, {key: test.rate * run.rate.factor for key, test in tests.items()}


def _anchor(run: RunResult, found: Answers, spent: dict[tuple[str, str], float]) -> tuple[str, float]:
    """The curve of the first anchor that passes somewhere and what its pick spends; NaN if none does."""
    for name in run.schema.anchors:
        for answer in found.answers:
            if answer.curve.split(" ")[0] == name and (lowest := answer.limit.lowest) is not None:
                return answer.curve, spent[answer.curve, lowest.point]
    return "", math.nan


@dataclass(frozen=True)
class _Axis:
    """A logarithmic axis between two powers of ten."""

    low: float
    high: float

    @classmethod
    def around(cls, values: Iterable[float]) -> _Axis:
        logs = [math.log10(value) for value in values if 0.0 < value < math.inf]
        low, high = min(logs, default=0.0), max(logs, default=0.0)
        wider = max(0.0, math.log10(_NARROWEST) - (high - low)) / 2.0
        margin = _MARGIN * (high - low + 2.0 * wider)
        return cls(low - wider - margin, high + wider + margin)

    def place(self, value: float) -> float | None:
        """In percent; None of what has no logarithm."""
        if not 0.0 < value < math.inf:
            return None
        return round(100.0 * (math.log10(value) - self.low) / (self.high - self.low), 2)

    @property
    def ticks(self) -> tuple[tuple[float | None, str], ...]:
        powers = range(math.floor(self.low), math.ceil(self.high) + 1)
        for steps in _STEPS:
            every = [float(f"{step}e{power}") for power in powers for step in steps]
            inside = [value for value in every if self.low <= math.log10(value) <= self.high]
            if len(inside) >= 3:
                break
        kept = inside[:: math.ceil(len(inside) / _MOST_TICKS)]
        return tuple((self.place(value), f"{value:g}") for value in kept)
