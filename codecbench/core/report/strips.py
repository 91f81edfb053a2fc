"""A strip for each codec: all settings that were tried over what they spend, which of them pass, and the pick."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Final

from codecbench.core.analysis.passing import Passing, Standing, describe
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.answers import Answers, anchor_of
from codecbench.core.report.choosing import candidates_over_links, limit_of
from codecbench.core.report.costs import bit_rate_mbps, coding_ms, deciding_cost, rate_cell, times_decide
from codecbench.core.report.tables import three_digits

_MARGIN: Final = 0.05
"""Of the axis that stays free at either end."""
_TIME: Final = "ms"
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


@dataclass(frozen=True)
class _Tried:
    """A setting that was tried. value: what it spends, NaN if that is not known. why: what was found, in words."""

    setting: str
    value: float
    verdict: Passing
    why: str


@dataclass(frozen=True)
class _Sweep:
    """All that was tried of a curve, from the most that is spent to the least. after: what is known beyond the pick."""

    curve: str
    tried: tuple[_Tried, ...]
    pick: _Tried | None
    after: str


def strips(run: RunResult, found: Answers) -> Strips | None:
    """The strips of an answer; None where no setting was judged."""
    if not found.answers:
        return None
    unit, values = _spent(run, found)
    sweeps = []
    for each in found.answers:
        tried = tuple(
            _Tried(test.point or "its setting", values[each.curve, test.point], test.verdict, describe(test))
            for test in each.limit.settings
        )
        at = None if each.limit.lowest is None else each.limit.settings.index(each.limit.lowest)
        after = each.limit.reason or (each.limit.after_words() if each.limit.settings else "no run")
        sweeps.append(_Sweep(each.curve, tried, None if at is None else tried[at], after))
    anchor = anchor_of(run, found)
    return _drawn(found.about, unit, sweeps, "" if anchor is None else anchor.curve)


def link_strips(run: RunResult) -> list[Strips]:
    """The strips over each link by which a run is judged, over all sequences together."""
    found = []
    for own in candidates_over_links(run):
        unit, of_curve = "", defaultdict[str, list[_Tried]](list)
        for each in own:
            setting = Standing(each.point, each.rate, 0, 0)
            unit, _ = rate_cell(run, each.sequence, each.curve, setting)
            factor = 1.0 if unit == "Mbit/s" or run.rate is None else run.rate.factor
            value = factor * deciding_cost(run, each.sequence, each.curve, setting)
            name = " ".join(filter(None, (each.point, each.way))) or "its setting"
            tried = _Tried(name, value, each.verdict, limit_of(each))
            of_curve[each.curve].insert(0, tried)
        sweeps = [_over_link(curve, tuple(tried)) for curve, tried in of_curve.items()]
        sweeps.sort(key=lambda sweep: math.inf if sweep.pick is None else sweep.pick.value)
        picked = [sweep.curve for sweep in sweeps if sweep.pick is not None]
        base = next((curve for curve in picked if curve.split(" ")[0] in run.schema.anchors), "")
        found.append(_drawn(f"what comes over {own[0].demand.link}", unit, sweeps, base))
    return found


def _over_link(curve: str, tried: tuple[_Tried, ...]) -> _Sweep:
    """Over a link finer settings may fail for want of room, so that the pick is the last that passes."""
    pick = next((each for each in reversed(tried) if each.verdict == "passes"), None)
    nearest = sorted(tried, key=lambda each: each.verdict == "fails")
    coarser = nearest if pick is None else tried[tried.index(pick) + 1 :]
    after = next((f"{each.setting} {each.verdict} ({each.why})" for each in coarser), "nothing coarser was tried")
    return _Sweep(curve, tried, pick, after)


def _drawn(about: str, unit: str, sweeps: Sequence[_Sweep], base: str) -> Strips:
    """base: the curve beside whose pick the others' stand."""
    axis = _Axis.around(each.value for sweep in sweeps for each in sweep.tried)
    least = next((sweep.pick.value for sweep in sweeps if sweep.curve == base and sweep.pick), math.nan)

    def cost(value: float) -> str:
        return "" if math.isnan(value) else f"{three_digits(value)} {unit}"

    def saved(sweep: _Sweep, value: float) -> str:
        more = 100.0 * (value / least - 1.0)
        if sweep.curve == base or math.isnan(more):
            return "the anchor" if sweep.curve == base else ""
        share = f"{abs(more):.0f} % {'less' if more < 0.0 else 'more'}"
        return f"{share} {'time ' if unit == _TIME else ''}than {base}"

    def row(sweep: _Sweep) -> Row:
        marks = []
        for each in sweep.tried:
            why = f" ({each.why})" if each.why else ""
            words = f"{', '.join(filter(None, (each.setting, cost(each.value))))}: {each.verdict}{why}"
            marks.append(Mark(each.setting, each.verdict, words, axis.place(each.value), each is sweep.pick))
        if sweep.pick is None:
            fails = sweep.tried and all(each.verdict == "fails" for each in sweep.tried)
            return Row(sweep.curve, "", "passes nowhere" if fails else "no pick", "", sweep.after, tuple(marks))
        value = sweep.pick.value
        return Row(sweep.curve, sweep.pick.setting, cost(value), saved(sweep, value), sweep.after, tuple(marks))

    return Strips(about, unit, axis.ticks, tuple(map(row, sweeps)))


def _spent(run: RunResult, found: Answers) -> tuple[str, dict[tuple[str, str], float]]:
    """What each setting spends by curve and point, and the unit: what decides between them, in one unit for all."""
    tests = {(answer.curve, test.point): test for answer in found.answers for test in answer.limit.settings}
    if times_decide(run):
        return _TIME, {key: sum(coding_ms(run, found.on, key[0], test)) for key, test in tests.items()}
    mbps = {key: bit_rate_mbps(run, found.on, key[0], test) for key, test in tests.items()}
    if mbps and all(value > 0.0 for value in mbps.values()):
        return "Mbit/s", mbps
    assert run.rate is not None
    return run.rate.unit, {key: test.rate * run.rate.factor for key, test in tests.items()}


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
