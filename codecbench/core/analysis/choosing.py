"""Settings over a link, judged by what is asked of them: frames in time, and a reader that errs little by them."""

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
from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.simulation.settings import LinkSettings

TOO_OLD: Final = "older than the deadline"

FRESH_SHARE: Final = 0.5
"""Of the moments: so many at least need a fresh pose, or it is no tracking."""

_ROUNDING: Final = 1e-9
"""Relative differences up to this are none."""

Shortfall = Literal["time", "failed", "fresh", "error", "idle", "unmeasured", "runs"]
"""What keeps a setting from passing: too few frames in time, runs that failed, too few fresh poses, an error that is
larger than asked or no smaller than with nothing received, what was not measured, too few runs."""

UNTOLD: Final = "the error with nothing received"
"""What records lack, with the share of fresh poses, that were made before it was measured."""


class NotMeasured(CodecbenchError):
    """A run lacks what is asked of it: a link, a reader, or the times of encoding."""


@dataclass(frozen=True)
class Demand:
    """What is asked: over which link, in how many of the frames at least (share) no older than deadline_ms, with an
    error of at most error_m. What is None is not asked. device_factor: how many times slower the device is than the
    machine that timed encoding, which makes each frame as much older; None where encoding takes no time."""

    link: str
    deadline_ms: float | None = None
    error_m: float | None = None
    share: float = 0.95
    device_factor: float | None = None


@dataclass(frozen=True)
class Reading:
    """What a reader made of a run: its error, that with nothing received, and the share of the moments at which it had
    a fresh pose; NaN where not measured. is_done: whether the run ended with a result."""

    error_m: float
    idle_m: float
    fresh: float
    is_done: bool

    def shortfall(self, demand: Demand) -> Shortfall | None:
        """The first thing that is known to be missing for a success."""
        if not self.is_done:
            return "failed"
        if self.fresh < FRESH_SHARE:
            return "fresh"
        if demand.error_m is not None and self.error_m > demand.error_m:
            return "error"
        return "idle" if self.error_m >= self.idle_m * (1.0 - _ROUNDING) else None


@dataclass(frozen=True)
class Candidate:
    """A codec setting over a link, on a sequence or on all (POOLED).

    way: what tells its transport and so on from others of the run. rate: of the table; NaN where not known. timely,
    useful: how many runs had enough frames in time, and in how many a reader was a success; None where not measured or
    asked. share: of frames in time. causes: shares of the frames that were not in time, by label, largest first.
    readings: of each run. error_m, idle_m, fresh: their medians.
    """

    sequence: str
    curve: str
    point: str
    way: str
    rate: float
    demand: Demand
    timely: Standing | None
    share: float
    causes: dict[str, float]
    useful: Standing | None
    readings: tuple[Reading, ...]
    error_m: float
    idle_m: float
    fresh: float
    unmeasured: tuple[str, ...]

    @property
    def name(self) -> str:
        return " ".join(filter(None, (self.curve, self.point, f"({self.way})" if self.way else "")))

    @property
    def standings(self) -> list[Standing]:
        return [standing for standing in (self.timely, self.useful) if standing is not None]

    @property
    def verdict(self) -> Passing:
        """`fails` where one demand does, `passes` where all do."""
        verdicts = {standing.verdict for standing in self.standings}
        if "fails" in verdicts:
            return "fails"
        return "passes" if verdicts == {"passes"} and not self.unmeasured else "inconclusive"

    @property
    def limit(self) -> Shortfall | None:
        """What keeps it from passing most often; None where it passes."""
        if self.verdict == "passes":
            return None
        if self.verdict == "inconclusive" and self.unmeasured:
            return "unmeasured"
        short = Counter(found for reading in self.readings if (found := reading.shortfall(self.demand)))
        common: Shortfall = short.most_common(1)[0][0] if short else "runs"
        reasons: tuple[tuple[Standing | None, Shortfall], ...] = ((self.timely, "time"), (self.useful, common))
        for standing, reason in reasons:
            if standing is not None and standing.verdict == self.verdict and standing.successes < standing.runs:
                return reason
        return "runs"

    @property
    def more_runs(self) -> int:
        """How many more would tell, if all ended as most have."""
        return max((standing.more_runs for standing in self.standings), default=0)

    @property
    def least_sure(self) -> Standing:
        """Of a setting that passes, the standing that says least."""
        return min(self.standings, key=lambda standing: standing.interval[0])


def median(values: Iterable[float]) -> float:
    """Of those that are known; NaN where none is."""
    known = [value for value in values if not math.isnan(value)]
    return float(np.median(known)) if known else math.nan


_Way = tuple[tuple[str, str], ...]
_Setting = tuple[str, str, str, _Way]
"""Sequence, codec, label, and way."""
_Run = tuple[tuple[float, dict[str, float]] | None, Reading | None]
"""The share of the frames in time with the causes of the others, and what a reader made of it, as far as measured."""


def candidates(run: RunResult, demand: Demand) -> list[Candidate]:
    """Every setting that was measured over the link, in order of rate; with several sequences those of all come first.

    Raises NotMeasured where none was, where frames in time are not asked and nothing reads them, and where times of
    encoding are asked that the run does not have.
    """
    run = run.as_calibrated
    over_link = [result for result in run.results if demand.link in _links(result.cell.evaluator)]
    if demand.device_factor is not None and any(result.cell.evaluator.params.get("encode_ms") for result in over_link):
        raise NotMeasured(
            f"{run.folder}: over {demand.link} the time of encoding was simulated with encode_ms, on a device as slow "
            "as device_factor of the matrix says; leave the factor away here"
        )
    encode_ms = _encode_ms(run, demand)
    found: dict[_Setting, list[_Run]] = defaultdict(list)
    for result in over_link:
        if result.status != "unsupported":
            frames = _frames(result, demand, encode_ms.get(result.row, 0.0))
            found[*result.row, _way(result.cell.evaluator)].append((frames, _reading(result)))
    if not found:
        links = links_of(run)
        there = f"it has {', '.join(links)}" if links else "no evaluator of it has a link"
        raise NotMeasured(f"{run.folder}: nothing was measured over link {demand.link!r}; {there}")
    is_read = demand.link in links_read(run)
    if not is_read and demand.deadline_ms is None:
        raise NotMeasured(f"{run.folder}: no error was measured over {demand.link}; ask for a deadline")
    rates = dict(run.rates)
    if len({setting[0] for setting in found}) > 1:
        for (_, *rest), runs in list(found.items()):
            found[POOLED, rest[0], rest[1], rest[2]] += runs  # type: ignore[index]
        rates |= pooled_rates(run)
    words = _words_of_ways({setting[3] for setting in found})
    judged = [
        _judged(
            run.curves[setting[1:3]],
            setting[0],
            runs,
            rates.get(setting[:3], math.nan),
            words[setting[3]],
            demand,
            is_read,
        )
        for setting, runs in found.items()
    ]
    return sorted(judged, key=_place)


def _place(candidate: Candidate) -> tuple[bool, str, bool, float]:
    """All sequences together first; a rate that is not known comes last."""
    return candidate.sequence != POOLED, candidate.sequence, math.isnan(candidate.rate), candidate.rate


def links_of(run: RunResult) -> list[str]:
    """The links over which a run has measured something, in the order of its plan."""
    return list(dict.fromkeys(link for result in run.results for link in _links(result.cell.evaluator)))


def links_read(run: RunResult) -> list[str]:
    """Those of them over which something reads the frames, so that its error is known."""
    read = {link for result in run.results if _with_quantity(result, "error") for link in _links(result.cell.evaluator)}
    return [link for link in links_of(run) if link in read]


def _links(evaluator: PluginSetting) -> list[str]:
    return [used.name for used in evaluator.uses if used.kind == "link"]


def _way(evaluator: PluginSetting) -> _Way:
    """All about the link but its name: equal for evaluators that look at the same journey."""
    names = [name for name in LinkSettings.model_fields if name in evaluator.params and name != "link"]
    return tuple((name, json.dumps(evaluator.params[name], sort_keys=True)) for name in names)


def _words_of_ways(ways: Iterable[_Way]) -> dict[_Way, str]:
    """What tells each way from the others."""
    values: dict[str, set[str]] = defaultdict(set)
    ways = list(ways)
    for way in ways:
        for name, value in way:
            values[name].add(value)
    return {
        way: " ".join(f"{name}={json.loads(value)}" for name, value in way if len(values[name]) > 1) for way in ways
    }


def _encode_ms(run: RunResult, demand: Demand) -> dict[Key, float]:
    """What encoding a picture takes on the device, by row."""
    if demand.device_factor is None:
        return {}
    found: dict[Key, list[float]] = defaultdict(list)
    for result in run.results:
        timed = _with_quantity(result, "encoding")
        typical = None if timed is None else result.summaries.get((timed.name, "", timed.aggregates[0]))
        if typical is not None:
            found[result.row].append(typical)
    if not found:
        raise NotMeasured(f"{run.folder}: no encoding was timed; add an evaluator that does, or leave the factor away")
    return {row: demand.device_factor * float(np.median(values)) for row, values in found.items()}


def _frames(result: CellResult, demand: Demand, encode_ms: float) -> tuple[float, dict[str, float]] | None:
    """The share of the frames in time, and the causes of the others. A cell that failed had no frame in time."""
    delay = _with_quantity(result, "delay")
    if delay is None or demand.deadline_ms is None:
        return None
    share = float((result.values_of_frames(delay.name) + encode_ms <= demand.deadline_ms).mean())
    causes = {
        result.metrics[found.metric].label: found.value
        for found in result.measurements
        if found.metric in result.metrics and result.metrics[found.metric].quantity == "cause"
    }
    return share, {**causes, TOO_OLD: max(0.0, 1.0 - share - sum(causes.values()))}


def _reading(result: CellResult) -> Reading | None:
    if _with_quantity(result, "error") is None:
        return None
    return Reading(_value(result, "error"), _value(result, "idle"), _value(result, "fresh"), result.status == "ok")


def _value(result: CellResult, quantity: Quantity) -> float:
    metric = _with_quantity(result, quantity)
    values = [found.value for found in result.measurements if metric is not None and found.metric == metric.name]
    return values[0] if values else math.nan


def _with_quantity(result: CellResult, quantity: Quantity) -> Metric | None:
    return next((metric for metric in result.metrics.values() if metric.quantity == quantity), None)


def _judged(
    at: CurvePoint, sequence: str, runs: list[_Run], rate: float, way: str, demand: Demand, is_read: bool
) -> Candidate:
    """is_read: whether anything reads frames over the link, by which all settings are judged then."""
    shares = [frames[0] for frames, _ in runs if frames is not None]
    causes = [frames[1] for frames, _ in runs if frames is not None]
    readings = tuple(reading for _, reading in runs if reading is not None)
    timely = [share >= demand.share - _ROUNDING for share in shares]
    # what is not known counts as a success, so that a setting fails only if it does so in any case
    useful = [reading.shortfall(demand) is None for reading in readings]
    unsure = [reading for reading in readings if reading.shortfall(demand) is None]
    unmeasured = {
        "frames in time": demand.deadline_ms is not None and not timely,
        "the error": (is_read and not readings) or any(math.isnan(reading.error_m) for reading in unsure),
        UNTOLD: any(math.isnan(reading.idle_m + reading.fresh) for reading in unsure),
    }
    means = {cause: float(np.mean([each.get(cause, 0.0) for each in causes])) for each in causes for cause in each}
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
