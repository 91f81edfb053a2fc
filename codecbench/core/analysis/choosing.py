"""Settings over a link, judged by what is asked of them: pictures in time, and a reader of them that errs little."""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import groupby
from typing import Final

import numpy as np

from codecbench.core.analysis.evidence import combined, evidence_of_repeats
from codecbench.core.analysis.limits import POOLED, pooled_rates
from codecbench.core.analysis.passing import Passing, Standing
from codecbench.core.analysis.run_result import Key, RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.metric import Metric, Need
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.simulation.settings import LinkSettings

TOO_OLD: Final = "older than the deadline"

RunKey = tuple[str, int]
"""A sequence and a repeat on it: a run that every setting meets with the same luck."""


class NotMeasured(CodecbenchError):
    """A run lacks what is asked of it: a link, or the times of encoding."""


@dataclass(frozen=True)
class Demand:
    """What is asked: over which link, in how many of the pictures at least (share) no older than deadline_ms, with an
    error of at most error_m. What is None is not asked. device_factor: how many times slower the device is than the
    machine that timed encoding, which makes each picture as much older; None where encoding takes no time."""

    link: str
    deadline_ms: float | None = None
    error_m: float | None = None
    share: float = 0.95
    device_factor: float | None = None


@dataclass(frozen=True)
class Candidate:
    """A codec setting over a link, on a sequence or on all (POOLED).

    way: what tells its transport and so on from others of the run. rate: of the table; NaN where not known. timely,
    exact: how many runs had enough pictures in time, and how many erred little enough; None where not measured or
    asked. share: of pictures in time. error_m: median over runs. causes: shares of the pictures that were not in time,
    by label, largest first. errors_m: of each run, NaN where it failed.
    """

    sequence: str
    curve: str
    point: str
    way: str
    rate: float
    timely: Standing | None
    share: float
    causes: dict[str, float]
    exact: Standing | None
    error_m: float
    unmeasured: tuple[str, ...]
    errors_m: Mapping[RunKey, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return " ".join(filter(None, (self.curve, self.point, f"({self.way})" if self.way else "")))

    @property
    def standings(self) -> list[Standing]:
        return [standing for standing in (self.timely, self.exact) if standing is not None]

    @property
    def verdict(self) -> Passing:
        """`fails` where one demand does, `passes` where all do."""
        verdicts = {standing.verdict for standing in self.standings}
        if "fails" in verdicts:
            return "fails"
        return "passes" if verdicts == {"passes"} and not self.unmeasured else "inconclusive"

    @property
    def more_runs(self) -> int:
        """How many more would tell, if all ended as most have."""
        return max((standing.more_runs for standing in self.standings), default=0)


@dataclass
class _Runs:
    """What the runs of a setting gave, one value a run."""

    shares: list[float] = field(default_factory=list)
    causes: list[dict[str, float]] = field(default_factory=list)
    errors_m: dict[RunKey, float] = field(default_factory=dict)

    def add(self, other: _Runs) -> None:
        self.shares += other.shares
        self.causes += other.causes
        self.errors_m |= other.errors_m


_Way = tuple[tuple[str, str], ...]
_Setting = tuple[str, str, str, _Way]
"""Sequence, codec, label, and way."""


def candidates(run: RunResult, demand: Demand) -> list[Candidate]:
    """Every setting that was measured over the link, in order of rate; with several sequences those of all come first.

    Raises NotMeasured where none was, and where times of encoding are asked that the run does not have.
    """
    over_link = [result for result in run.results if demand.link in _links(result.cell.evaluator)]
    if demand.device_factor is not None and any(result.cell.evaluator.params.get("encode_ms") for result in over_link):
        raise NotMeasured(
            f"{run.folder}: over {demand.link} the time of encoding was simulated with encode_ms, on a device as slow "
            "as device_factor of the matrix says; leave the factor away here"
        )
    encode_ms = _encode_ms(run, demand)
    found: dict[_Setting, _Runs] = defaultdict(_Runs)
    for result in over_link:
        if result.status != "unsupported":
            setting = (*result.row, _way(result.cell.evaluator))
            _collect(found[setting], result, demand, encode_ms.get(result.row, 0.0))
    if not found:
        links = links_of(run)
        there = f"it has {', '.join(links)}" if links else "no evaluator of it has a link"
        raise NotMeasured(f"{run.folder}: nothing was measured over link {demand.link!r}; {there}")
    rates = dict(run.rates)
    if len({setting[0] for setting in found}) > 1:
        for (_, *rest), runs in list(found.items()):
            found[POOLED, rest[0], rest[1], rest[2]].add(runs)  # type: ignore[index]
        rates |= pooled_rates(run)
    words = _words_of_ways({setting[3] for setting in found})
    judged = [
        _judged(run, setting, runs, rates.get(setting[:3], math.nan), words[setting[3]], demand)
        for setting, runs in found.items()
    ]
    return sorted(judged, key=_place)


def _place(candidate: Candidate) -> tuple[bool, str, bool, float]:
    """All sequences together first; a rate that is not known comes last."""
    return candidate.sequence != POOLED, candidate.sequence, math.isnan(candidate.rate), candidate.rate


def links_of(run: RunResult) -> list[str]:
    """The links over which a run has measured something, in the order of its plan."""
    return list(dict.fromkeys(link for result in run.results for link in _links(result.cell.evaluator)))


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
        timed = _with_need(result, "encoding")
        median = None if timed is None else result.summaries.get((timed.name, "", timed.aggregates[0]))
        if median is not None:
            found[result.row].append(median)
    if not found:
        raise NotMeasured(f"{run.folder}: no encoding was timed; add an evaluator that does, or leave the factor away")
    return {row: demand.device_factor * float(np.median(values)) for row, values in found.items()}


def _collect(runs: _Runs, result: CellResult, demand: Demand, encode_ms: float) -> None:
    """Add what a cell says. One that failed had no picture in time, and an error beyond all."""
    delay, error = (_with_need(result, need) for need in ("delay", "error"))
    if delay is not None and demand.deadline_ms is not None:
        in_time = result.values_of_frames(delay.name) + encode_ms <= demand.deadline_ms
        share = float(in_time.mean())
        runs.shares.append(share)
        causes = {
            result.metrics[found.metric].label: found.value
            for found in result.measurements
            if found.metric in result.metrics and result.metrics[found.metric].need == "cause"
        }
        runs.causes.append({**causes, TOO_OLD: max(0.0, 1.0 - share - sum(causes.values()))})
    if error is not None and demand.error_m is not None:
        values = [found.value for found in result.measurements if found.metric == error.name]
        runs.errors_m[result.cell.sequence.name, result.cell.repeat] = values[0] if values else math.nan


def _with_need(result: CellResult, need: Need) -> Metric | None:
    return next((metric for metric in result.metrics.values() if metric.need == need), None)


def _judged(run: RunResult, setting: _Setting, runs: _Runs, rate: float, way: str, demand: Demand) -> Candidate:
    sequence, codec, label, _ = setting
    point = run.curves[codec, label]
    enough = [share >= demand.share - 1e-9 for share in runs.shares]
    near = [demand.error_m is not None and error <= demand.error_m for error in runs.errors_m.values()]
    asked = (("pictures in time", demand.deadline_ms, enough), ("the error", demand.error_m, near))
    labels = dict.fromkeys(label for causes in runs.causes for label in causes)
    means = {label: float(np.mean([causes.get(label, 0.0) for causes in runs.causes])) for label in labels}
    return Candidate(
        sequence, point.curve, point.point, way, rate,
        Standing(point.point, rate, sum(enough), len(enough)) if enough else None,
        float(np.mean(runs.shares)) if runs.shares else math.nan,
        dict(sorted(means.items(), key=lambda pair: -pair[1])),
        Standing(point.point, rate, sum(near), len(near)) if near else None,
        float(np.median(list(runs.errors_m.values()))) if runs.errors_m else math.nan,
        tuple(what for what, limit, measured in asked if limit is not None and not measured),
        runs.errors_m,
    )  # fmt: skip


_SIGNIFICANCE: Final = 0.05
"""Chance that the setting that errs least is said to be worse than another."""


@dataclass(frozen=True)
class LeastError:
    """What a run answers of a link, on a sequence or on all (POOLED).

    best: the setting of the least error. error_m: its geometric mean over runs. worse: those that are known to err
    more. level: all others, in order of rate, any of which may be the best. runs: of each setting.
    """

    link: str
    sequence: str
    best: Candidate
    error_m: float
    worse: tuple[Candidate, ...]
    level: tuple[Candidate, ...]
    runs: int

    @property
    def is_told(self) -> bool:
        """Whether no other setting may be the best."""
        return not self.level and bool(self.worse)


def least_errors(run: RunResult) -> list[LeastError]:
    """The answers of every link over which errors were measured: of all sequences together first, where several."""
    found = []
    for link in links_of(run):
        demand = Demand(link, deadline_ms=math.inf, error_m=math.inf)
        for sequence, members in groupby(candidates(run, demand), key=lambda candidate: candidate.sequence):
            judged = [candidate for candidate in members if candidate.errors_m]
            if judged and (answer := _least(link, sequence, judged)):
                found.append(answer)
    return found


def _least(link: str, sequence: str, judged: list[Candidate]) -> LeastError | None:
    """None where no run that all settings share has an error. A run that failed counts as the worst of all runs."""
    shared = sorted(set.intersection(*(set(candidate.errors_m) for candidate in judged)))
    table = np.array([[candidate.errors_m[key] for key in shared] for candidate in judged])
    finite = table[np.isfinite(table) & (table > 0.0)]
    if not len(finite):
        return None
    logs = np.log(np.clip(np.where(np.isnan(table), math.inf, table), finite.min(), finite.max()))
    means = np.array([_mean(dict(zip(shared, row, strict=True))) for row in logs])
    at = int(np.argmin(means))
    limit = _SIGNIFICANCE / max(1, len(judged) - 1)
    is_worse = [_chance(dict(zip(shared, row - logs[at], strict=True))) < limit for row in logs]
    others = [(candidate, worse) for place, (candidate, worse) in enumerate(zip(judged, is_worse, strict=True))
              if place != at]  # fmt: skip
    return LeastError(
        link,
        sequence,
        judged[at],
        float(np.exp(means[at])),
        tuple(candidate for candidate, worse in others if worse),
        tuple(candidate for candidate, worse in others if not worse),
        len(shared),
    )


def _by_sequence(values: Mapping[RunKey, float]) -> list[np.ndarray]:
    of: dict[str, list[float]] = defaultdict(list)
    for (sequence, _), value in values.items():
        of[sequence].append(value)
    return [np.array(members) for members in of.values()]


def _mean(values: Mapping[RunKey, float]) -> float:
    """Over sequences of the same weight."""
    return float(np.mean([members.mean() for members in _by_sequence(values)]))


def _chance(differences: Mapping[RunKey, float]) -> float:
    """One-sided, that such differences are above zero by luck."""
    evidence = combined([evidence_of_repeats(members) for members in _by_sequence(differences)])
    return evidence.p_value / 2.0 if evidence.mean > 0.0 else 1.0
