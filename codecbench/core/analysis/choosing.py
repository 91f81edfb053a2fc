"""Judges settings over a link by frames before the deadline and by the error of a reader (SLAM, for example)."""

from __future__ import annotations

import json
import math
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from codecbench.core.analysis.limits import POOLED, pooled_rates
from codecbench.core.analysis.passing import Passing, Standing
from codecbench.core.analysis.run_result import CurvePoint, Key, RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.analysis.verdicts import median
from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.simulation.settings import LinkSettings

TOO_OLD: Final = "older than the deadline"

FRESH_SHARE: Final = 0.5
"""Minimum share of capture times with a fresh pose; below it the reader does not track."""

_ROUNDING: Final = 1e-9
"""Relative difference up to which values are equal."""

Shortfall = Literal["time", "failed", "fresh", "error", "idle", "unmeasured", "runs"]
"""What keeps a setting from passing.

time: too few frames before the deadline. failed: runs that failed. fresh: too few fresh poses. error: an error larger
than asked. idle: an error no smaller than with nothing received. unmeasured: no value. runs: too few runs."""

IDLE_ERROR: Final = "the error with nothing received"
"""What old records do not have; they lack the share of fresh poses too."""


class NotMeasured(CodecbenchError):
    """A run lacks what a demand needs: a link, a reader, or the times of encoding."""


@dataclass(frozen=True)
class Demand:
    """The requirements on a setting over a link; None asks for nothing."""

    link: str
    deadline_ms: float | None = None
    """Greatest age of a frame on arrival."""
    error_m: float | None = None
    """Greatest error of the reader."""
    share: float = 0.95
    """Minimum share of frames before the deadline."""
    device_factor: float | None = None
    """How many times slower the device encodes than the machine that timed it; None if encoding takes no time."""


@dataclass(frozen=True)
class Reading:
    """What a reader made of the frames of a run; NaN for what was not measured."""

    error_m: float
    idle_m: float
    """The error with nothing received."""
    fresh: float
    """Share of the capture times with a fresh pose."""
    is_done: bool
    """Whether the run ended with a result."""

    def shortfall(self, demand: Demand) -> Shortfall | None:
        """Return the first known reason against a success; None if there is none."""
        if not self.is_done:
            return "failed"
        if self.fresh < FRESH_SHARE:
            return "fresh"
        if demand.error_m is not None and self.error_m > demand.error_m:
            return "error"
        return "idle" if self.error_m >= self.idle_m * (1.0 - _ROUNDING) else None


@dataclass(frozen=True)
class Candidate:
    """A codec setting over a link, on a sequence or on all (POOLED)."""

    sequence: str
    curve: str
    point: str
    way: str
    """The link parameters that differ within the run, such as the transport, in words."""
    rate: float
    """As in the table; NaN if unknown."""
    demand: Demand
    timely: Standing | None
    """How many runs had enough frames before the deadline; None if not measured or not asked."""
    share: float
    """Share of frames before the deadline."""
    causes: dict[str, float]
    """Shares of the frames that missed the deadline, by the label of the cause, largest first."""
    useful: Standing | None
    """In how many runs the reader succeeded; None if not measured."""
    readings: tuple[Reading, ...]
    """One a run."""
    error_m: float
    """Median over the readings, as idle_m and fresh."""
    idle_m: float
    fresh: float
    unmeasured: tuple[str, ...]
    """Labels of what was asked and not measured."""

    @property
    def name(self) -> str:
        return " ".join(filter(None, (self.curve, self.point, f"({self.way})" if self.way else "")))

    @property
    def standings(self) -> list[Standing]:
        return [standing for standing in (self.timely, self.useful) if standing is not None]

    @property
    def verdict(self) -> Passing:
        """`fails` if one standing does, `passes` if all do."""
        verdicts = {standing.verdict for standing in self.standings}
        if "fails" in verdicts:
            return "fails"
        return "passes" if verdicts == {"passes"} and not self.unmeasured else "inconclusive"

    @property
    def limit(self) -> Shortfall | None:
        """The commonest obstacle to passing; None if the setting passes."""
        if self.verdict == "passes":
            return None
        if self.verdict == "inconclusive" and self.unmeasured:
            return "unmeasured"
        short = Counter(shortfall for reading in self.readings if (shortfall := reading.shortfall(self.demand)))
        common: Shortfall = short.most_common(1)[0][0] if short else "runs"
        reasons: tuple[tuple[Standing | None, Shortfall], ...] = ((self.timely, "time"), (self.useful, common))
        for standing, reason in reasons:
            if standing is not None and standing.verdict == self.verdict and standing.successes < standing.runs:
                return reason
        return "runs"

    @property
    def more_runs(self) -> int:
        """How many more runs would decide, if all ended as most have."""
        return max((standing.more_runs for standing in self.standings), default=0)

    @property
    def least_sure(self) -> Standing:
        """The standing with the lowest bound on its success rate."""
        return min(self.standings, key=lambda standing: standing.interval[0])


_Way = tuple[tuple[str, str], ...]
"""Link parameters by name, as JSON."""
_Setting = tuple[str, str, str, _Way]
"""Sequence, codec, label, and way."""
_Run = tuple[tuple[float, dict[str, float]] | None, Reading | None]
"""The share of frames before the deadline with the causes of the others, and the reading, as far as measured."""


def candidates(run: RunResult, demand: Demand) -> list[Candidate]:
    """Judge every setting that was measured over the link, in order of rate; those over all sequences come first.

    Raises NotMeasured if nothing was measured over the link, if the demand has no deadline and the run no reader, or if
    the demand needs encoding times that the run lacks.
    """
    run = run.as_calibrated
    over_link = [result for result in run.results if demand.link in _links(result.cell.evaluator)]
    if demand.device_factor is not None and any(result.cell.evaluator.params.get("encode_ms") for result in over_link):
        raise NotMeasured(
            f"{run.folder}: the run over {demand.link} already simulated the encoding time (encode_ms and "
            "device_factor of the matrix); omit the factor here"
        )
    encode_ms = _encode_ms(run, demand)
    runs_by_setting: dict[_Setting, list[_Run]] = defaultdict(list)
    for result in over_link:
        if result.status != "unsupported":
            frames = _frames(result, demand, encode_ms.get(result.row, 0.0))
            runs_by_setting[*result.row, _way(result.cell.evaluator)].append((frames, _reading(result)))
    if not runs_by_setting:
        links = links_of(run)
        there = f"it has {', '.join(links)}" if links else "none of its evaluators has a link"
        raise NotMeasured(f"{run.folder}: nothing was measured over link {demand.link!r}; {there}")
    is_read = demand.link in links_with_readers(run)
    if not is_read and demand.deadline_ms is None:
        raise NotMeasured(f"{run.folder}: no error was measured over {demand.link}; give a deadline")
    rates = dict(run.rates)
    if len({setting[0] for setting in runs_by_setting}) > 1:
        for (_, *rest), runs in list(runs_by_setting.items()):
            runs_by_setting[POOLED, rest[0], rest[1], rest[2]] += runs  # type: ignore[index]
        rates |= pooled_rates(run)
    words = _describe_ways({setting[3] for setting in runs_by_setting})
    settings = [
        _candidate(
            run.curves[setting[1:3]],
            setting[0],
            runs,
            rates.get(setting[:3], math.nan),
            words[setting[3]],
            demand,
            is_read,
        )
        for setting, runs in runs_by_setting.items()
    ]
    return sorted(settings, key=_place)


def _place(candidate: Candidate) -> tuple[bool, str, bool, float]:
    """The sort key: all sequences together first, an unknown rate last."""
    return candidate.sequence != POOLED, candidate.sequence, math.isnan(candidate.rate), candidate.rate


def links_of(run: RunResult) -> list[str]:
    """The links over which a run measured something, in the order of its plan."""
    return list(dict.fromkeys(link for result in run.results for link in _links(result.cell.evaluator)))


def links_with_readers(run: RunResult) -> list[str]:
    """The links whose frames a reader uses, so that its error is known, in the order of the plan."""
    read = {link for result in run.results if _metric_with(result, "error") for link in _links(result.cell.evaluator)}
    return [link for link in links_of(run) if link in read]


def _links(evaluator: PluginSetting) -> list[str]:
    return [used.name for used in evaluator.uses if used.kind == "link"]


def _way(evaluator: PluginSetting) -> _Way:
    """The link parameters without the link's name: equal for evaluators that simulate the same transmission."""
    names = [name for name in LinkSettings.model_fields if name in evaluator.params and name != "link"]
    return tuple((name, json.dumps(evaluator.params[name], sort_keys=True)) for name in names)


def _describe_ways(ways: Iterable[_Way]) -> dict[_Way, str]:
    """Describe each way by the parameters that differ."""
    values: dict[str, set[str]] = defaultdict(set)
    ways = list(ways)
    for way in ways:
        for name, value in way:
            values[name].add(value)
    return {
        way: " ".join(f"{name}={json.loads(value)}" for name, value in way if len(values[name]) > 1) for way in ways
    }


def _encode_ms(run: RunResult, demand: Demand) -> dict[Key, float]:
    """The time of encoding a frame on the device, by row."""
    if demand.device_factor is None:
        return {}
    times: dict[Key, list[float]] = defaultdict(list)
    for result in run.results:
        timed = _metric_with(result, "encoding")
        typical = None if timed is None else result.summaries.get((timed.name, "", timed.aggregates[0]))
        if typical is not None:
            times[result.row].append(typical)
    if not times:
        raise NotMeasured(
            f"{run.folder}: no encoding time was measured; add an evaluator that measures it, or omit the factor"
        )
    return {row: demand.device_factor * float(np.median(values)) for row, values in times.items()}


def _frames(result: CellResult, demand: Demand, encode_ms: float) -> tuple[float, dict[str, float]] | None:
    """The share of frames before the deadline, and the causes of the others; a failed cell has a share of 0."""
    delay = _metric_with(result, "delay")
    if delay is None or demand.deadline_ms is None:
        return None
    share = float((result.values_of_frames(delay.name) + encode_ms <= demand.deadline_ms).mean())
    causes = {
        result.metrics[measured.metric].label: measured.value
        for measured in result.measurements
        if measured.metric in result.metrics and result.metrics[measured.metric].quantity == "cause"
    }
    return share, {**causes, TOO_OLD: max(0.0, 1.0 - share - sum(causes.values()))}


def _reading(result: CellResult) -> Reading | None:
    if _metric_with(result, "error") is None:
        return None
    return Reading(_value(result, "error"), _value(result, "idle"), _value(result, "fresh"), result.status == "ok")


def _value(result: CellResult, quantity: Quantity) -> float:
    metric = _metric_with(result, quantity)
    values = [
        measured.value for measured in result.measurements if metric is not None and measured.metric == metric.name
    ]
    return values[0] if values else math.nan


def _metric_with(result: CellResult, quantity: Quantity) -> Metric | None:
    return next((metric for metric in result.metrics.values() if metric.quantity == quantity), None)


def _candidate(
    at: CurvePoint, sequence: str, runs: list[_Run], rate: float, way: str, demand: Demand, is_read: bool
) -> Candidate:
    """Judge the runs of a setting. is_read: whether a reader uses the link's frames, which then judges all settings."""
    shares = [frames[0] for frames, _ in runs if frames is not None]
    causes = [frames[1] for frames, _ in runs if frames is not None]
    readings = tuple(reading for _, reading in runs if reading is not None)
    timely = [share >= demand.share - _ROUNDING for share in shares]
    # an unknown counts as a success, so that a setting fails only if it fails in any case
    useful = [reading.shortfall(demand) is None for reading in readings]
    unsure = [reading for reading in readings if reading.shortfall(demand) is None]
    unmeasured = {
        "the share of frames on time": demand.deadline_ms is not None and not timely,
        "the error": (is_read and not readings) or any(math.isnan(reading.error_m) for reading in unsure),
        IDLE_ERROR: any(math.isnan(reading.idle_m + reading.fresh) for reading in unsure),
    }
    labels = [label for causes_of_run in causes for label in causes_of_run]
    means = {label: float(np.mean([of_run.get(label, 0.0) for of_run in causes])) for label in labels}
    return Candidate(
        sequence, at.curve, at.point, way, rate, demand,
        Standing(at.point, rate, sum(timely), len(timely)) if timely else None,
        float(np.mean(shares)) if shares else math.nan,
        dict(sorted(means.items(), key=lambda pair: -pair[1])),
        Standing(at.point, rate, sum(useful), len(useful)) if useful else None,
        readings,
        median(reading.error_m for reading in readings),
        median(reading.idle_m for reading in readings),
        median(reading.fresh for reading in readings),
        tuple(what for what, is_missing in unmeasured.items() if is_missing),
    )  # fmt: skip
