"""Aims: a declared metric of an evaluator, and the value that it is to have."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, field_validator

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.metric import AGGREGATES, Metric
from codecbench.core.engine.planning.declared import read_declaration
from codecbench.core.engine.planning.description import InvalidParams, describe
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.planning.search_section import Bound, ObjectiveSection
from codecbench.core.engine.planning.yaml_file import Problems, Where, plain_value
from codecbench.core.engine.plugins.registry import Registry


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
    found = list(_candidates(section.metric, evaluators))
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
    return [metric for value in declared if (metric := read_declaration(Metric, value)) is not None]


def _candidates(text: str, evaluators: Sequence[Entry]) -> Iterator[tuple[PluginSetting, Metric, str, str]]:
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


def metric_sources(quantity: str, evaluators: Sequence[Entry]) -> list[tuple[Entry, Metric]]:
    """The evaluators that measure something and await nothing themselves, each with its metric."""
    found = ((entry, metric) for entry in evaluators if not entry.requires for metric in metrics_of(entry))
    return [(entry, metric) for entry, metric in found if metric.quantity == quantity]


def require_sources(evaluators: Sequence[Entry], registry: Registry, problems: Problems) -> None:
    """Note a problem with every parameter that awaits what none of the evaluators measures, or several do."""
    for entry in evaluators:
        for parameter, quantity in entry.requires.items():
            found = [source.setting.title for source, _ in metric_sources(quantity, evaluators)]
            if len(found) == 1:
                continue
            value, place = entry.setting.params.get(parameter), (*entry.where, "params", parameter)
            if found:
                message = f"{value!r} is the time of {quantity}, which several evaluators measure"
                message += f": {', '.join(found)}; keep one of them, or give milliseconds"
            else:
                known = " or ".join(_installed_sources(quantity, registry)) or "one that does"
                message = f"{value!r} is the time of {quantity}, which no evaluator of this matrix measures"
                message += f"; add {known}, or give milliseconds"
            problems.add(place, message)


def _installed_sources(quantity: str, registry: Registry) -> list[str]:
    """Installed evaluators that measure something with their usual parameters."""
    names = []
    for plugin in registry.plugins("evaluator"):
        try:
            declared = describe(registry, "evaluator", plugin.spec.name, {}).declared
        except (CodecbenchError, InvalidParams):
            continue
        metrics = (read_declaration(Metric, value) for value in declared.get("metrics", ()))
        if any(metric is not None and metric.quantity == quantity for metric in metrics):
            names.append(plugin.spec.name)
    return names


class UntilSection(BaseModel):
    """`decided`: the name of a metric of role `success`, or a metric with `min` or `max`."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    decided: ObjectiveSection = Field(
        description="a metric of role success by its name, or {metric: NAME, min: NUMBER}"
    )

    @field_validator("decided", mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:
        return {"metric": value, "min": 1} if isinstance(value, str) else value

    @field_validator("decided")
    @classmethod
    def _bounded(cls, value: ObjectiveSection) -> ObjectiveSection:
        if value.equal is not None:
            raise ValueError("takes min or max: a repeat meets it or does not")
        return value


def find_decided_objective(
    section: UntilSection | None, root: Any, evaluators: Sequence[Entry], problems: Problems
) -> Objective | None:
    """What is to be decided; None where nothing is, or, with a problem, where it cannot be."""
    if section is None:
        return None
    where = ("run", "until", "decided")
    objective = find_objective(section.decided, evaluators, where, problems)
    if objective is None:
        return None
    if isinstance(plain_value(root["run"]["until"]["decided"]), str) and objective.metric.role != "success":
        message = f"{objective.metric.name} is no success or failure; give it a limit: {{metric: NAME, max: NUMBER}}"
        problems.add(where, message)
        return None
    if repeats_of(objective.evaluator.title, evaluators) < 2:
        problems.add(
            where, f"evaluator {objective.evaluator.title} has a single repeat; give it as many as may be spent"
        )
        return None
    return objective


def repeats_of(title: str, evaluators: Sequence[Entry]) -> int:
    """How many repeats an evaluator's setting has; 1 where it cannot be used here."""
    for entry in evaluators:
        if entry.setting.title == title and entry.description is not None:
            return max(1, len(entry.description.identities))
    return 1
