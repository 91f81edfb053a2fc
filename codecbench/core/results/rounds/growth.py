"""The next round of a run: what searches try next, repeats that are to decide something, cells that awaited others."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path

from codecbench.core.engine.planning.matrix import Matrix
from codecbench.core.engine.planning.model import Plan, PluginSetting, SearchFinding
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.planning.search import EVERY, Extent
from codecbench.core.engine.planning.until import repeats_of
from codecbench.core.engine.registry import Registry
from codecbench.core.engine.storage.store import Store
from codecbench.core.results.collect import read_run
from codecbench.core.results.rounds.awaiting import Awaited
from codecbench.core.results.rounds.deciding import repeats_to_decide
from codecbench.core.results.rounds.searching import Searching
from codecbench.core.results.rounds.sequential import runs_to_make
from codecbench.core.results.rounds.trials import CellKey, Trials
from codecbench.core.results.run_result import RunResult


class Growth:
    """Makes the plan of a matrix again, as far as the records in a run folder lead.

    What is planned follows from the matrix and those records alone. So a run that was stopped, however it ended, plans
    the same again and computes what is missing of it.
    """

    def __init__(self, matrix: Matrix, folder: Path, registry: Registry) -> None:
        self._matrix, self._store, self._registry = matrix, Store(folder), registry
        self._totals = {entry.setting.title: repeats_of(entry.setting.title, matrix.evaluators)
                        for entry in matrix.evaluators}  # fmt: skip

    @cached_property
    def _awaited(self) -> Awaited:
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
        return self(make_plan(self._matrix, self._registry, extent=Extent(begun=self._begun)))

    def __call__(self, plan: Plan) -> Plan:
        """The plan with all that is to be computed by now; the plan itself where that is all there is."""
        while True:
            extent, findings = self._asked(read_run(self._store, self._read_of(plan), self._registry))
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
        needed = {evaluator.title for search in self._matrix.searches for evaluator in search.evaluators}
        needed |= self._awaited.all_titles
        if self._matrix.until is not None:
            needed |= {self._matrix.until.evaluator.title}
            rates = plan.declared.get("evaluators", {}).items()
            needed |= {title for title, declared in rates if _measures_rate(declared)}
        return replace(plan, cells=tuple(cell for cell in plan.cells if cell.evaluator.title in needed))

    def _asked(self, run: RunResult) -> tuple[Extent, list[SearchFinding]]:
        matrix, trials = self._matrix, Trials(run, self._totals)
        findings: list[SearchFinding] = []
        settings = [entry.setting for entry in matrix.codecs if entry.wanted is None]
        always = [(sequence.name, setting) for sequence in run.plan.sequences for setting in settings]
        found: list[tuple[str, PluginSetting]] = []
        for search in matrix.searches:
            for sequence in run.plan.sequences:
                finding, answer = Searching(search, sequence.name, trials, matrix.run.seed).result()
                findings.append(finding)
                if answer is not None:
                    found.append((sequence.name, answer))
        repeats: dict[CellKey, int] = {}
        for sequence_name, setting in found:
            repeats |= {(sequence_name, setting, title): EVERY for title in self._totals}
        if matrix.until is not None:
            title = matrix.until.evaluator.title
            decided = dict.fromkeys([*always, *found])
            repeats |= repeats_to_decide(run, trials, matrix.until, self._totals[title], decided)
        for key, count in trials.asked.items():
            repeats[key] = max(count, repeats.get(key, 0))
        for sequence_name, setting, title in list(repeats):
            repeats |= {(sequence_name, setting, awaited): EVERY for awaited in self._awaited.titles(title)}
        return Extent(repeats, self._begun, self._awaited.found(run)), findings


def _measures_rate(declared: dict[str, object]) -> bool:
    metrics = declared.get("metrics")
    return isinstance(metrics, list) and any(
        metric.get("role") == "rate" and metric.get("headline") for metric in metrics
    )
