"""Aims: a declared metric of an evaluator, and the value that it is to have."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from codecbench.core.contracts.metric import AGGREGATES, Metric
from codecbench.core.engine.planning.declared import read_declared
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.planning.search_section import Bound, ObjectiveSection
from codecbench.core.engine.planning.yaml_file import Problems, Where


@dataclass(frozen=True)
class Objective:
    """An aggregate of a metric of an evaluator's setting, and the value that it is to have."""

    evaluator: PluginSetting
    metric: Metric
    stage: str
    aggregate: str
    bound: Bound
    value: float

    def met_by(self, value: float) -> bool:
        """Whether a value will do; NaN never does."""
        return value >= self.value if self.bound == "min" else value <= self.value

    def distance(self, value: float) -> float:
        """How far a value is from the objective: a difference, or that of logarithms on a logarithmic scale."""
        if math.isnan(value):
            return math.inf
        if self.metric.scale == "log" and min(value, self.value) > 0:
            return abs(math.log(value) - math.log(self.value))
        return abs(value - self.value)

    def __str__(self) -> str:
        sign = {"min": "≥", "max": "≤", "equal": "="}[self.bound]
        return f"{self.name} {sign} {self.value:g}"

    @property
    def name(self) -> str:
        """The metric with what distinguishes it: its stage, and its aggregate where that is not the usual one."""
        parts = [self.metric.name, self.stage, "" if self.aggregate == self.metric.aggregates[0] else self.aggregate]
        return ".".join(filter(None, parts))


def find_objective(
    section: ObjectiveSection, evaluators: Sequence[Entry], where: Where, problems: Problems
) -> Objective | None:
    """Find the metric that a section names among those of the evaluators; None, and a problem, if there is none."""
    found = list(_meanings(section.metric, evaluators))
    if len(found) == 1:
        evaluator, metric, stage, how = found[0]
        if how not in metric.aggregates:
            message = f"{metric.name} is not summarised as {how}; it is as {', '.join(metric.aggregates)}"
            problems.add((*where, "metric"), message)
            return None
        bound = section.bound
        return Objective(evaluator, metric, stage, how, bound, float(getattr(section, bound)))
    place = (*where, "metric")
    if found:
        names = ", ".join(f"{evaluator.title}.{section.metric}" for evaluator, *_ in found)
        problems.add(place, f"several evaluators measure {section.metric!r}; say which: {names}")
        return None
    if any(entry.description is None for entry in evaluators):
        problems.add(place, f"no evaluator that can be used here measures {section.metric!r}")
        return None
    measured = [metric.name for entry in evaluators for metric in metrics_of(entry)]
    near = difflib.get_close_matches(section.metric.split(".")[-1], measured, n=1)
    meant = f"did you mean {near[0]!r}? " if near else ""
    problems.add(
        place, f"no evaluator of this matrix measures {section.metric!r}; {meant}there are {', '.join(measured)}"
    )
    return None


def metrics_of(entry: Entry) -> list[Metric]:
    """What an evaluator declares; nothing where it cannot be used here."""
    declared = entry.description.declared.get("metrics", ()) if entry.description else ()
    return [metric for value in declared if (metric := read_declared(Metric, value)) is not None]


def _meanings(text: str, evaluators: Sequence[Entry]) -> Iterator[tuple[PluginSetting, Metric, str, str]]:
    """Evaluator, metric, stage and aggregate that a name may mean."""
    for entry in evaluators:
        for metric in metrics_of(entry):
            for name in (metric.name, f"{entry.setting.title}.{metric.name}"):
                rest = text.removeprefix(name)
                if rest == text or (rest and not rest.startswith(".")):
                    continue
                stage, _, last = rest[1:].rpartition(".")
                how = last if last in AGGREGATES else ""
                yield entry.setting, metric, stage if how else rest[1:], how or metric.aggregates[0]
