"""What the records of a run hold for evaluators that await what another one measures."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.awaited import sources
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.model import Cell, PluginSetting
from codecbench.core.results.columns import Column
from codecbench.core.results.rounds.trials import CellKey
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.table import CellResult
from codecbench.core.results.verdicts import values_in

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
            for parameter, need in entry.awaits.items():
                source, metric = sources(need, evaluators)[0]
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
