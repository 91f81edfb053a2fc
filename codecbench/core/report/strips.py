"""A strip for each codec: all settings tried over their cost, with their verdicts and the pick."""

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
"""Share of the axis that stays free at either end."""
_TIME: Final = "ms"
_NARROWEST: Final = 4.0
"""Least factor that an axis spans, so that settings of similar cost appear close together."""
_MOST_TICKS: Final = 6
_STEPS: Final = ((1,), (1, 3), (1, 2, 5), tuple(range(1, 10)))
"""Ticks of the axis, times powers of ten; the first that gives three of them is used."""


@dataclass(frozen=True)
class Mark:
    """A setting of a codec on the axis."""

    setting: str
    verdict: Passing
    words: str
    """The setting, its cost and its verdict."""
    place: float | None
    """Percent of the axis; None if its cost is unknown."""
    is_pick: bool


@dataclass(frozen=True)
class Row:
    """The strip of a codec."""

    curve: str
    pick: str
    """The setting to take."""
    cost: str
    """Of the pick, or that there is none."""
    saved: str
    """The difference from the cost of the anchor's pick."""
    after: str
    """The first setting after the pick that does not pass, in words."""
    marks: tuple[Mark, ...]
    """From the highest cost to the lowest."""

    @property
    def words(self) -> str:
        """The verdicts of the marks as text: `a, b: passes; c: fails`."""
        groups = groupby(self.marks, key=lambda mark: mark.verdict)
        return "; ".join(f"{', '.join(mark.setting for mark in marks)}: {verdict}" for verdict, marks in groups)


@dataclass(frozen=True)
class Strips:
    """Rows in the order of the answer, above one logarithmic axis."""

    about: str
    unit: str
    ticks: tuple[tuple[float | None, str], ...]
    """Percent of the axis, and text."""
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class _Trial:
    """A setting that was tried."""

    setting: str
    value: float
    """Its cost; NaN if unknown."""
    verdict: Passing
    why: str
    """The reason of the verdict, in words."""


@dataclass(frozen=True)
class _Sweep:
    """The trials of a curve, from the highest cost to the lowest."""

    curve: str
    trials: tuple[_Trial, ...]
    pick: _Trial | None
    after: str
    """The first setting after the pick that does not pass, in words."""


def strips(run: RunResult, answers: Answers) -> Strips | None:
    """The strips of an answer; None if no setting was judged."""
    if not answers.answers:
        return None
    unit, values = _costs(run, answers)
    sweeps = []
    for answer in answers.answers:
        curve, limit = answer.curve, answer.limit
        trials = tuple(
            _Trial(test.point or "its setting", values[curve, test.point], test.verdict, describe(test))
            for test in limit.settings
        )
        at = None if limit.lowest is None else limit.settings.index(limit.lowest)
        after = limit.reason or (limit.after_words() if limit.settings else "no run")
        sweeps.append(_Sweep(curve, trials, None if at is None else trials[at], after))
    anchor = anchor_of(run, answers)
    return _lay_out(answers.about, unit, sweeps, "" if anchor is None else anchor.curve)


def link_strips(run: RunResult) -> list[Strips]:
    """The strips over each link with a reader, over all sequences together."""
    by_link = []
    for settings in candidates_over_links(run):
        unit, of_curve = "", defaultdict[str, list[_Trial]](list)
        for candidate in settings:
            setting = Standing(candidate.point, candidate.rate, 0, 0)
            unit, _ = rate_cell(run, candidate.sequence, candidate.curve, setting)
            factor = 1.0 if unit == "Mbit/s" or run.rate is None else run.rate.factor
            value = factor * deciding_cost(run, candidate.sequence, candidate.curve, setting)
            name = " ".join(filter(None, (candidate.point, candidate.way))) or "its setting"
            of_curve[candidate.curve].insert(0, _Trial(name, value, candidate.verdict, limit_of(candidate)))
        sweeps = [_sweep_over_link(curve, tuple(trials)) for curve, trials in of_curve.items()]
        sweeps.sort(key=lambda sweep: math.inf if sweep.pick is None else sweep.pick.value)
        picked = [sweep.curve for sweep in sweeps if sweep.pick is not None]
        base = next((curve for curve in picked if curve.split(" ")[0] in run.schema.anchors), "")
        by_link.append(_lay_out(f"frames over {settings[0].demand.link}", unit, sweeps, base))
    return by_link


def _sweep_over_link(curve: str, trials: tuple[_Trial, ...]) -> _Sweep:
    """The sweep of a curve over a link; the pick is the last that passes, as finer settings may exceed the capacity."""
    pick = next((trial for trial in reversed(trials) if trial.verdict == "passes"), None)
    nearest = sorted(trials, key=lambda trial: trial.verdict == "fails")
    coarser = nearest if pick is None else trials[trials.index(pick) + 1 :]
    after = next((f"{trial.setting} {trial.verdict} ({trial.why})" for trial in coarser), "nothing coarser was tried")
    return _Sweep(curve, trials, pick, after)


def _lay_out(about: str, unit: str, sweeps: Sequence[_Sweep], base: str) -> Strips:
    """Place the trials on one axis. base: the curve whose pick the others' are compared with."""
    axis = _Axis.around(trial.value for sweep in sweeps for trial in sweep.trials)
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
        for trial in sweep.trials:
            why = f" ({trial.why})" if trial.why else ""
            words = f"{', '.join(filter(None, (trial.setting, cost(trial.value))))}: {trial.verdict}{why}"
            marks.append(Mark(trial.setting, trial.verdict, words, axis.place(trial.value), trial is sweep.pick))
        if sweep.pick is None:
            fails = sweep.trials and all(trial.verdict == "fails" for trial in sweep.trials)
            return Row(sweep.curve, "", "passes nowhere" if fails else "no pick", "", sweep.after, tuple(marks))
        value = sweep.pick.value
        return Row(sweep.curve, sweep.pick.setting, cost(value), saved(sweep, value), sweep.after, tuple(marks))

    return Strips(about, unit, axis.ticks, tuple(map(row, sweeps)))


def _costs(run: RunResult, answers: Answers) -> tuple[str, dict[tuple[str, str], float]]:
    """The unit, and in it the cost of each setting by curve and point that decides between settings."""
    tests = {(answer.curve, test.point): test for answer in answers.answers for test in answer.limit.settings}
    if times_decide(run):
        return _TIME, {key: sum(coding_ms(run, answers.on, key[0], test)) for key, test in tests.items()}
    mbps = {key: bit_rate_mbps(run, answers.on, key[0], test) for key, test in tests.items()}
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
        """A value's place in percent; None if it has no logarithm."""
        if not 0.0 < value < math.inf:
            return None
        return round(100.0 * (math.log10(value) - self.low) / (self.high - self.low), 2)

    @property
    def ticks(self) -> tuple[tuple[float | None, str], ...]:
        powers = range(math.floor(self.low), math.ceil(self.high) + 1)
        for steps in _STEPS:
            possible = [float(f"{step}e{power}") for power in powers for step in steps]
            inside = [value for value in possible if self.low <= math.log10(value) <= self.high]
            if len(inside) >= 3:
                break
        thinned = inside[:: math.ceil(len(inside) / _MOST_TICKS)]
        return tuple((self.place(value), f"{value:g}") for value in thinned)
