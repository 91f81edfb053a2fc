"""The next round of a run: what searches try next, repeats that are to decide something, cells that awaited others."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from codecbench.core.analysis.collect import read_run
from codecbench.core.analysis.passing import Passing
from codecbench.core.analysis.run_result import Column, RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.analysis.verdicts import values_in
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.estimate import estimate
from codecbench.core.engine.planning.inputs import sources
from codecbench.core.engine.planning.matrix import Matrix
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting, SearchFinding
from codecbench.core.engine.planning.objective import Objective
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.planning.search import ALL_REPEATS, PlanScope
from codecbench.core.engine.planning.until import repeats_of
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.storage.store import Store
from codecbench.core.rounds.edge import Edge
from codecbench.core.rounds.searching import Searching
from codecbench.core.rounds.trials import CellKey, Trials, column_of, runs_to_make, verdict


class Growth:
    """Makes the plan of a matrix again, as far as the records in a run folder lead.

    What is planned follows from the matrix and those records alone. So a run that was stopped, however it ended, plans
    the same again and computes what is missing of it. end_s: of the monotonic clock; searches try more only if that can
    be expected to be done by then.
    """

    end_s = math.inf

    def __init__(self, matrix: Matrix, folder: Path, registry: Registry) -> None:
        self._matrix, self._store, self._registry = matrix, Store(folder), registry
        self._totals = {entry.setting.title: repeats_of(entry.setting.title, matrix.evaluators)
                        for entry in matrix.evaluators}  # fmt: skip

    @cached_property
    def _inputs(self) -> Awaited:
        return Awaited(self._matrix.evaluators, self._totals | self._begun)

    @cached_property
    def _begun(self) -> dict[str, int]:
        """How many repeats there are at first where they are added as needed, by the title of the evaluator."""
        if self._matrix.until is None:
            return {}
        title = self._matrix.until.evaluator.title
        return {title: runs_to_make(0, 0, self._totals[title])}

    def planned(self) -> Plan:
        """The plan of a run that begins or goes on."""
        return self(make_plan(self._matrix, self._registry, extent=PlanScope(begun=self._begun)))

    def __call__(self, plan: Plan) -> Plan:
        """The plan with all that is to be computed by now; the plan itself where that is all there is.

        If time is short, the first searches that fit go on: several only if as much time again is left to end them.
        """
        known = {cell.id for cell in plan.cells}
        for searches in range(len(self._matrix.searches), 0, -1):
            grown = self._grown(plan, searches)
            more = [cell for cell in grown.cells
                    if cell.id not in known and not self._store.record_folder(cell.id).exists()]  # fmt: skip
            if self._in_time(plan, grown, more, times=2 if searches > 1 else 1):
                return grown
            left = {cell.id for cell in more}
            plan = replace(plan, cells=tuple(cell for cell in grown.cells if cell.id not in left))
        return self._grown(plan, 0)

    def _in_time(self, plan: Plan, grown: Plan, more: list[Cell], times: int) -> bool:
        """Whether more cells of a plan that has grown can be expected to be done so many times by the end."""
        if self.end_s == math.inf or not more:
            return True
        begun = {job.id for job in plan.jobs}
        results = read_run(self._store, self._read_of(plan), self._registry).results
        durations = {result.cell.id: result.duration_s for result in results if result.duration_s}
        seconds = estimate(grown, more, sum(job.id not in begun for job in grown.jobs), durations).seconds
        return time.monotonic() + times * seconds <= self.end_s

    def _grown(self, plan: Plan, searches: int) -> Plan:
        """As `__call__`; only so many searches, the first ones, may try more."""
        while True:
            run = read_run(self._store, self._read_of(plan), self._registry)
            extent, findings = self._asked(run, searches)
            grown = make_plan(self._matrix, self._registry, extent=extent, sequences=plan.sequences)
            grown = replace(grown, searches=tuple(findings))
            known = {cell.id for cell in plan.cells}
            more = [cell.id for cell in grown.cells if cell.id not in known]
            if not more:
                return replace(plan, searches=grown.searches)
            if not any(self._store.record_folder(cell_id).exists() for cell_id in more):
                return grown
            plan = grown

    def _read_of(self, plan: Plan) -> Plan:
        """The plan with the cells alone that decide how it goes on."""
        if any(search.objective is None for search in self._matrix.searches):
            return plan
        needed = {evaluator.title for search in self._matrix.searches for evaluator in search.evaluators}
        needed |= self._inputs.all_titles
        if self._matrix.until is not None:
            needed |= {self._matrix.until.evaluator.title}
            rates = plan.declared.get("evaluators", {}).items()
            needed |= {title for title, declared in rates if _measures_rate(declared)}
        return replace(plan, cells=tuple(cell for cell in plan.cells if cell.evaluator.title in needed))

    def _asked(self, run: RunResult, searches: int) -> tuple[PlanScope, list[SearchFinding]]:
        matrix, trials = self._matrix, Trials(run, self._totals)
        findings: list[SearchFinding] = []
        settings = [entry.setting for entry in matrix.codecs if entry.wanted is None]
        always = [(sequence.name, setting) for sequence in run.plan.sequences for setting in settings]
        found: list[tuple[str, PluginSetting]] = []
        names = [sequence.name for sequence in run.plan.sequences]
        for place, search in enumerate(matrix.searches):
            before, in_time = dict(trials.asked), place < searches
            answers: dict[str, PluginSetting] = {}
            for name in names:
                seeking = (Edge(search, name, trials, in_time) if search.objective is None else
                           Searching(search, name, trials, matrix.run.seed, in_time))  # fmt: skip
                finding, answer = seeking.result()
                findings.append(finding)
                if answer is not None:
                    answers[name] = answer
            if not in_time:
                trials.withdraw(before)
            if search.objective is None and len(answers) == len(names):  # each on all, to be judged over all
                found += [(name, setting) for name in names for setting in dict.fromkeys(answers.values())]
            else:
                found += answers.items()
        repeats: dict[CellKey, int] = {}
        for sequence_name, setting in found:
            repeats |= {(sequence_name, setting, title): ALL_REPEATS for title in self._totals}
        if matrix.until is not None:
            title = matrix.until.evaluator.title
            decided = dict.fromkeys([*always, *found])
            repeats |= repeats_to_decide(run, trials, matrix.until, self._totals[title], decided)
        for key, count in trials.asked.items():
            repeats[key] = max(count, repeats.get(key, 0))
        for sequence_name, setting, title in list(repeats):
            repeats |= {(sequence_name, setting, inputs): ALL_REPEATS for inputs in self._inputs.titles(title)}
        return PlanScope(repeats, self._begun, self._inputs.found(run)), findings


def _measures_rate(declared: dict[str, object]) -> bool:
    metrics = declared.get("metrics")
    return isinstance(metrics, list) and any(
        metric.get("role") == "rate" and metric.get("headline") for metric in metrics
    )


_Found = dict[str, float] | str


@dataclass(frozen=True)
class Source:
    """Where the value of a parameter comes from. repeats: so many, the first ones, are looked at."""

    evaluator: PluginSetting
    metric: Metric
    repeats: int

    def value(self, cells: Sequence[Cell], found: Mapping[str, CellResult]) -> float | str | None:
        """The median over repeats of what each gives for its frames; why there is none, or None while some are missing.

        cells: those of the evaluator. found: results by the id of a cell.
        """
        first = [found.get(cell.id) for cell in cells if cell.repeat < self.repeats]
        results = [result for result in first if result is not None]
        bad = next((result for result in results if result.status != "ok"), None)
        if bad is not None:
            return f"{self.evaluator.title} {bad.status}: {bad.reason}"
        if not first or len(results) < len(first):
            return None
        column = Column(self.evaluator, self.metric, "", self.metric.aggregates[0])
        values = [value for result in results for value in values_in(result, column)[:1] if math.isfinite(value)]
        return float(np.median(values)) if values else f"{self.evaluator.title} gives no {self.metric.name} here"


class Awaited:
    """Finds what is awaited among the results of a run.

    repeats: how many of an evaluator, by title, are certain to be made; of later ones nothing depends.
    """

    def __init__(self, evaluators: Sequence[Entry], repeats: Mapping[str, int]) -> None:
        self._sources: dict[str, dict[str, Source]] = {}
        for entry in evaluators:
            for parameter, quantity in entry.requires.items():
                source, metric = sources(quantity, evaluators)[0]
                title = source.setting.title
                self._sources.setdefault(entry.setting.title, {})[parameter] = Source(
                    source.setting, metric, repeats[title]
                )

    def titles(self, evaluator: str) -> set[str]:
        """The evaluators that one, by title, waits for."""
        return {source.evaluator.title for source in self._sources.get(evaluator, {}).values()}

    @property
    def all_titles(self) -> set[str]:
        """The evaluators that any waits for."""
        return {title for evaluator in self._sources for title in self.titles(evaluator)}

    def found(self, run: RunResult) -> dict[CellKey, _Found]:
        """By sequence, codec setting and evaluator, what was awaited, or why it never comes; nothing while it is not
        there."""
        cells: dict[CellKey, list[Cell]] = defaultdict(list)
        for cell in run.plan.cells:
            cells[cell.sequence.name, cell.codec, cell.evaluator.title].append(cell)
        results = {result.cell.id: result for result in run.results}
        found: dict[CellKey, _Found] = {}
        for evaluator, parameters in self._sources.items():
            for sequence, codec in {key[:2]: None for key in cells}:
                values = {
                    parameter: source.value(cells[sequence, codec, source.evaluator.title], results)
                    for parameter, source in parameters.items()
                }
                reasons = [f"{name}: {value}" for name, value in values.items() if isinstance(value, str)]
                numbers = {name: value for name, value in values.items() if isinstance(value, float)}
                if reasons:
                    found[sequence, codec, evaluator] = reasons[0]
                elif len(numbers) == len(parameters):
                    found[sequence, codec, evaluator] = numbers
        return found


def repeats_to_decide(
    run: RunResult, trials: Trials, objective: Objective, most: int, settings: Iterable[tuple[str, PluginSetting]]
) -> dict[CellKey, int]:
    """How many repeats of an evaluator each setting on a sequence is to have, at most `most`.

    The baseline has all: others are judged beside it. Of a curve, from the most rate down, repeats are added as far as
    the first setting that fails, because a limit is where all above it hold. A live error has no such limit, for what
    is too large for a link comes too late, and is judged by itself: so each setting is decided, the baseline too.
    """
    each = objective.metric.quantity == "error"
    found: dict[CellKey, int] = {}
    curves: dict[tuple[str, str], list[tuple[float, CellKey]]] = defaultdict(list)
    for sequence, setting in settings:
        key = sequence, setting, objective.evaluator.title
        if setting.name in run.schema.baselines and not each:
            found[key] = most
            continue
        place = (setting.name, setting.label)
        rate = run.rates.get((sequence, *place), math.nan)
        curve = run.curves[place].curve if place in run.curves else " ".join(place)
        curves[sequence, curve].append((math.inf if math.isnan(rate) else rate, key))
    for members in curves.values():
        failed_at = -math.inf
        for rate, key in sorted(members, key=lambda member: -member[0]):
            recorded = trials.recorded(*key)
            count, said = needed(recorded, objective, most)
            below = rate < failed_at and not each
            found[key] = max(runs_to_make(0, 0, most), len(recorded)) if below else count
            if said == "fails" and math.isfinite(rate):
                failed_at = max(failed_at, rate)
    return found


def needed(recorded: list[CellResult], objective: Objective, most: int) -> tuple[int, Passing]:
    """How many repeats a setting is to have, and what those that it has say.

    A repeat that has no value says nothing, one without a result does not do. Where none of the first says anything,
    more would not.
    """
    column = column_of(objective)
    count = runs_to_make(0, 0, most)
    while len(recorded) >= count:
        outcomes = [_outcome(result, objective, values_in(result, column)[:1]) for result in recorded[:count]]
        judged = [outcome for outcome in outcomes if outcome is not None]
        said = verdict(sum(judged), len(judged), len(judged) if count >= most else most)
        if said != "inconclusive" or count >= most or not judged:
            return max(count, len(recorded)), said
        count = min(most, count + runs_to_make(sum(judged), len(judged), most) - len(judged))
    return count, "inconclusive"


def _outcome(result: CellResult, objective: Objective, values: list[float]) -> bool | None:
    """Whether a repeat will do; None where it says nothing."""
    if result.status == "unsupported":
        return None
    if result.status != "ok" or not values:
        return False
    return None if math.isnan(values[0]) else objective.met_by(values[0])
