"""Plans the next round of a run: the next trials of searches, repeats until a decision, and cells that need results."""

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
from codecbench.core.engine.planning.matrix import Matrix
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting, SearchFinding
from codecbench.core.engine.planning.objective import Objective, metric_sources, repeats_of
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.planning.search import ALL_REPEATS, PlanScope
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.storage.store import Store
from codecbench.core.rounds.edge import Edge
from codecbench.core.rounds.searching import ParameterSearch
from codecbench.core.rounds.trials import CellKey, Trials, column_of, runs_to_make, verdict


class Growth:
    """Grows the plan of a matrix, as far as the records in a run folder allow.

    The plan depends only on the matrix and those records. So a run that was stopped in any way plans the same again and
    computes what is missing.
    """

    end_s = math.inf
    """Time of the monotonic clock; searches try more only if that can be expected to finish by then."""

    def __init__(self, matrix: Matrix, folder: Path, registry: Registry) -> None:
        self._matrix, self._store, self._registry = matrix, Store(folder), registry
        self._totals = {entry.setting.title: repeats_of(entry.setting.title, matrix.evaluators)
                        for entry in matrix.evaluators}  # fmt: skip

    @cached_property
    def _inputs(self) -> RequiredInputs:
        return RequiredInputs(self._matrix.evaluators, self._totals | self._initial_repeats)

    @cached_property
    def _initial_repeats(self) -> dict[str, int]:
        """The initial number of repeats, by the title of an evaluator whose repeats are added as needed."""
        if self._matrix.until is None:
            return {}
        title = self._matrix.until.evaluator.title
        return {title: runs_to_make(0, 0, self._totals[title])}

    def first_plan(self) -> Plan:
        """The plan of a run that begins or goes on."""
        return self(make_plan(self._matrix, self._registry, scope=PlanScope(begun=self._initial_repeats)))

    def __call__(self, plan: Plan) -> Plan:
        """Add all cells that can be computed by now; return the plan itself if there are none.

        If time is short, the first searches that fit go on: several only if as much time again remains to end them.
        """
        known = {cell.id for cell in plan.cells}
        for searches in range(len(self._matrix.searches), 0, -1):
            grown = self._grow(plan, searches)
            more = [cell for cell in grown.cells
                    if cell.id not in known and not self._store.record_folder(cell.id).exists()]  # fmt: skip
            if self._in_time(plan, grown, more, times=2 if searches > 1 else 1):
                return grown
            left = {cell.id for cell in more}
            plan = replace(plan, cells=tuple(cell for cell in grown.cells if cell.id not in left))
        return self._grow(plan, 0)

    def _in_time(self, plan: Plan, grown: Plan, more: list[Cell], times: int) -> bool:
        """Whether more cells of a grown plan can be expected to be computed so many times by the end."""
        if self.end_s == math.inf or not more:
            return True
        begun = {job.id for job in plan.jobs}
        results = read_run(self._store, self._deciding_part(plan), self._registry).results
        durations = {result.cell.id: result.duration_s for result in results if result.duration_s}
        seconds = estimate(grown, more, sum(job.id not in begun for job in grown.jobs), durations).seconds
        return time.monotonic() + times * seconds <= self.end_s

    def _grow(self, plan: Plan, searches: int) -> Plan:
        """Grow the plan as `__call__` does, with trials only of the first `searches` searches."""
        while True:
            run = read_run(self._store, self._deciding_part(plan), self._registry)
            extent, findings = self._next_scope(run, searches)
            grown = make_plan(self._matrix, self._registry, scope=extent, sequences=plan.sequences)
            grown = replace(grown, searches=tuple(findings))
            known = {cell.id for cell in plan.cells}
            more = [cell.id for cell in grown.cells if cell.id not in known]
            if not more:
                return replace(plan, searches=grown.searches)
            if not any(self._store.record_folder(cell_id).exists() for cell_id in more):
                return grown
            plan = grown

    def _deciding_part(self, plan: Plan) -> Plan:
        """The plan with only the cells that decide how it goes on."""
        if any(search.objective is None for search in self._matrix.searches):
            return plan
        needed = {evaluator.title for search in self._matrix.searches for evaluator in search.evaluators}
        needed |= self._inputs.all_titles
        if self._matrix.until is not None:
            needed |= {self._matrix.until.evaluator.title}
            rates = plan.declared.get("evaluators", {}).items()
            needed |= {title for title, declared in rates if _measures_rate(declared)}
        return replace(plan, cells=tuple(cell for cell in plan.cells if cell.evaluator.title in needed))

    def _next_scope(self, run: RunResult, searches: int) -> tuple[PlanScope, list[SearchFinding]]:
        """The scope of the next plan, and the findings of searches, of which the first `searches` may go on."""
        matrix, trials = self._matrix, Trials(run, self._totals)
        findings: list[SearchFinding] = []
        settings = [entry.setting for entry in matrix.codecs if entry.search is None]
        always = [(sequence.name, setting) for sequence in run.plan.sequences for setting in settings]
        chosen: list[tuple[str, PluginSetting]] = []
        names = [sequence.name for sequence in run.plan.sequences]
        for place, search in enumerate(matrix.searches):
            before, in_time = dict(trials.requested), place < searches
            answers: dict[str, PluginSetting] = {}
            for name in names:
                stepper = (Edge(search, name, trials, in_time) if search.objective is None else
                           ParameterSearch(search, name, trials, matrix.run.seed, in_time))  # fmt: skip
                finding, answer = stepper.result()
                findings.append(finding)
                if answer is not None:
                    answers[name] = answer
            if not in_time:
                trials.withdraw(before)
            if search.objective is None and len(answers) == len(names):  # each on all sequences, to be judged over all
                chosen += [(name, setting) for name in names for setting in dict.fromkeys(answers.values())]
            else:
                chosen += answers.items()
        repeats: dict[CellKey, int] = {}
        for sequence_name, setting in chosen:
            repeats |= {(sequence_name, setting, title): ALL_REPEATS for title in self._totals}
        if matrix.until is not None:
            title = matrix.until.evaluator.title
            settings_on = dict.fromkeys([*always, *chosen])
            repeats |= repeats_to_decide(run, trials, matrix.until, self._totals[title], settings_on)
        for key, count in trials.requested.items():
            repeats[key] = max(count, repeats.get(key, 0))
        for sequence_name, setting, title in list(repeats):
            repeats |= {(sequence_name, setting, inputs): ALL_REPEATS for inputs in self._inputs.titles(title)}
        return PlanScope(repeats, self._initial_repeats, self._inputs.values(run)), findings


def _measures_rate(declared: dict[str, object]) -> bool:
    metrics = declared.get("metrics")
    return isinstance(metrics, list) and any(
        metric.get("role") == "rate" and metric.get("headline") for metric in metrics
    )


_Inputs = dict[str, float] | str
"""Values by parameter, or why there are none."""


@dataclass(frozen=True)
class Source:
    """The metric that gives the value of a parameter."""

    evaluator: PluginSetting
    metric: Metric
    repeats: int
    """How many repeats count, from the first."""

    def value(self, cells: Sequence[Cell], by_cell: Mapping[str, CellResult]) -> float | str | None:
        """The median of the metric over repeats; why there is none, or None while repeats are missing.

        cells: those of the evaluator. by_cell: results by the id of a cell.
        """
        first = [by_cell.get(cell.id) for cell in cells if cell.repeat < self.repeats]
        results = [result for result in first if result is not None]
        bad = next((result for result in results if result.status != "ok"), None)
        if bad is not None:
            return f"{self.evaluator.title} {bad.status}: {bad.reason}"
        if not first or len(results) < len(first):
            return None
        column = Column(self.evaluator, self.metric, "", self.metric.aggregates[0])
        values = [value for result in results for value in values_in(result, column)[:1] if math.isfinite(value)]
        return float(np.median(values)) if values else f"{self.evaluator.title} measured no {self.metric.name} here"


class RequiredInputs:
    """Reads the inputs that evaluators require from the results of a run.

    repeats: how many repeats of an evaluator, by title, are certain to be computed; inputs depend only on these.
    """

    def __init__(self, evaluators: Sequence[Entry], repeats: Mapping[str, int]) -> None:
        self._sources: dict[str, dict[str, Source]] = {}
        for entry in evaluators:
            for parameter, quantity in entry.requires.items():
                source, metric = metric_sources(quantity, evaluators)[0]
                title = source.setting.title
                self._sources.setdefault(entry.setting.title, {})[parameter] = Source(
                    source.setting, metric, repeats[title]
                )

    def titles(self, evaluator: str) -> set[str]:
        """The evaluators that one, by title, requires."""
        return {source.evaluator.title for source in self._sources.get(evaluator, {}).values()}

    @property
    def all_titles(self) -> set[str]:
        """The evaluators that any other requires."""
        return {title for evaluator in self._sources for title in self.titles(evaluator)}

    def values(self, run: RunResult) -> dict[CellKey, _Inputs]:
        """The inputs by sequence, codec setting and evaluator, or why there are none; pending ones are left out."""
        cells: dict[CellKey, list[Cell]] = defaultdict(list)
        for cell in run.plan.cells:
            cells[cell.sequence.name, cell.codec, cell.evaluator.title].append(cell)
        results = {result.cell.id: result for result in run.results}
        inputs: dict[CellKey, _Inputs] = {}
        for evaluator, parameters in self._sources.items():
            for sequence, codec in {key[:2]: None for key in cells}:
                values = {
                    parameter: source.value(cells[sequence, codec, source.evaluator.title], results)
                    for parameter, source in parameters.items()
                }
                reasons = [f"{name}: {value}" for name, value in values.items() if isinstance(value, str)]
                numbers = {name: value for name, value in values.items() if isinstance(value, float)}
                if reasons:
                    inputs[sequence, codec, evaluator] = reasons[0]
                elif len(numbers) == len(parameters):
                    inputs[sequence, codec, evaluator] = numbers
        return inputs


def repeats_to_decide(
    run: RunResult, trials: Trials, objective: Objective, most: int, settings: Iterable[tuple[str, PluginSetting]]
) -> dict[CellKey, int]:
    """How many repeats of an evaluator each setting on a sequence needs, at most `most`.

    The baseline gets all, as others are compared with it. On a curve, repeats are added from the highest rate down to
    the first setting that fails, because a limit needs all settings above it to pass. A live error has no such limit:
    frames too large for a link arrive late. So every setting is decided on its own, the baseline too.
    """
    on_its_own = objective.metric.quantity == "error"
    repeats: dict[CellKey, int] = {}
    curves: dict[tuple[str, str], list[tuple[float, CellKey]]] = defaultdict(list)
    for sequence, setting in settings:
        key = sequence, setting, objective.evaluator.title
        if setting.name in run.schema.baselines and not on_its_own:
            repeats[key] = most
            continue
        place = (setting.name, setting.label)
        rate = run.rates.get((sequence, *place), math.nan)
        curve = run.curves[place].curve if place in run.curves else " ".join(place)
        curves[sequence, curve].append((math.inf if math.isnan(rate) else rate, key))
    for members in curves.values():
        failed_at = -math.inf
        for rate, key in sorted(members, key=lambda member: -member[0]):
            recorded = trials.recorded_repeats(*key)
            count, outcome = next_repeats(recorded, objective, most)
            below = rate < failed_at and not on_its_own
            repeats[key] = max(runs_to_make(0, 0, most), len(recorded)) if below else count
            if outcome == "fails" and math.isfinite(rate):
                failed_at = max(failed_at, rate)
    return repeats


def next_repeats(recorded: list[CellResult], objective: Objective, most: int) -> tuple[int, Passing]:
    """How many repeats a setting needs, and the verdict of those that it has.

    A repeat without a value does not count; one without a result fails. If none of the first counts, more would not.
    """
    column = column_of(objective)
    count = runs_to_make(0, 0, most)
    while len(recorded) >= count:
        outcomes = [_outcome(result, objective, values_in(result, column)[:1]) for result in recorded[:count]]
        judged = [outcome for outcome in outcomes if outcome is not None]
        passing = verdict(sum(judged), len(judged), len(judged) if count >= most else most)
        if passing != "inconclusive" or count >= most or not judged:
            return max(count, len(recorded)), passing
        count = min(most, count + runs_to_make(sum(judged), len(judged), most) - len(judged))
    return count, "inconclusive"


def _outcome(result: CellResult, objective: Objective, values: list[float]) -> bool | None:
    """Whether a repeat meets the objective; None if it does not count."""
    if result.status == "unsupported":
        return None
    if result.status != "ok" or not values:
        return False
    return None if math.isnan(values[0]) else objective.met_by(values[0])
