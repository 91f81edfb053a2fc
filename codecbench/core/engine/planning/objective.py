"""Resolve the metrics that a matrix names: objectives, the stopping rule of repeats, and inputs of evaluators."""

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
    """An aggregate of a metric of an evaluator's setting, and its target value."""

    evaluator: PluginSetting
    metric: Metric
    stage: str
    aggregate: str
    bound: Bound
    value: float

    def met_by(self, value: float) -> bool:
        """Whether a value meets the objective; NaN never does."""
        return value >= self.value if self.bound == "min" else value <= self.value

    def distance(self, value: float) -> float:
        """Return a value's distance from the target: a difference, of logarithms if the metric's scale is "log"."""
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
        """The metric with its stage, and with its aggregate if that is not the default one."""
        parts = [self.metric.name, self.stage, "" if self.aggregate == self.metric.aggregates[0] else self.aggregate]
        return ".".join(filter(None, parts))


def find_objective(
    section: ObjectiveSection, evaluators: Sequence[Entry], where: Where, problems: Problems
) -> Objective | None:
    """Find the metric that a section names among the evaluators'; if there is none, note a problem and return None."""
    candidates = list(_candidates(section.metric, evaluators))
    if len(candidates) == 1:
        evaluator, metric, stage, aggregate = candidates[0]
        if aggregate not in metric.aggregates:
            message = f"{metric.name} has no aggregate {aggregate}; it has {', '.join(metric.aggregates)}"
            problems.add((*where, "metric"), message)
            return None
        bound = section.bound
        return Objective(evaluator, metric, stage, aggregate, bound, float(getattr(section, bound)))
    place = (*where, "metric")
    if candidates:
        names = ", ".join(f"{evaluator.title}.{section.metric}" for evaluator, *_ in candidates)
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
    """Return the metrics that an evaluator declares; empty if it cannot be used here."""
    declared = entry.description.declared.get("metrics", ()) if entry.description else ()
    return [metric for value in declared if (metric := read_declaration(Metric, value)) is not None]


def _candidates(text: str, evaluators: Sequence[Entry]) -> Iterator[tuple[PluginSetting, Metric, str, str]]:
    """Yield each evaluator, metric, stage and aggregate that a name may refer to."""
    for entry in evaluators:
        for metric in metrics_of(entry):
            for name in (metric.name, f"{entry.setting.title}.{metric.name}"):
                rest = text.removeprefix(name)
                if rest == text or (rest and not rest.startswith(".")):
                    continue
                stage, _, aggregate_name = rest[1:].rpartition(".")
                aggregate = aggregate_name if aggregate_name in AGGREGATES else ""
                yield entry.setting, metric, stage if aggregate else rest[1:], aggregate or metric.aggregates[0]


def metric_sources(quantity: str, evaluators: Sequence[Entry]) -> list[tuple[Entry, Metric]]:
    """Return the evaluators that measure a quantity and require nothing themselves, each with its metric."""
    measured = ((entry, metric) for entry in evaluators if not entry.requires for metric in metrics_of(entry))
    return [(entry, metric) for entry, metric in measured if metric.quantity == quantity]


def require_sources(evaluators: Sequence[Entry], registry: Registry, problems: Problems) -> None:
    """Note a problem for every required quantity that no evaluator measures, or that several do."""
    for entry in evaluators:
        for parameter, quantity in entry.requires.items():
            titles = [source.setting.title for source, _ in metric_sources(quantity, evaluators)]
            if len(titles) == 1:
                continue
            value, place = entry.setting.params.get(parameter), (*entry.where, "params", parameter)
            if titles:
                message = f"{value!r} is the time of {quantity}, which several evaluators measure"
                message += f": {', '.join(titles)}; keep one of them, or give milliseconds"
            else:
                candidates = " or ".join(_installed_sources(quantity, registry)) or "one that does"
                message = f"{value!r} is the time of {quantity}, which no evaluator of this matrix measures"
                message += f"; add {candidates}, or give milliseconds"
            problems.add(place, message)


def _installed_sources(quantity: str, registry: Registry) -> list[str]:
    """Return the installed evaluators that measure a quantity with default parameters."""
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
        description="the name of a metric of role success, or {metric: NAME, min: NUMBER}"
    )

    @field_validator("decided", mode="before")
    @classmethod
    def _named(cls, value: Any) -> Any:
        return {"metric": value, "min": 1} if isinstance(value, str) else value

    @field_validator("decided")
    @classmethod
    def _bounded(cls, value: ObjectiveSection) -> ObjectiveSection:
        if value.equal is not None:
            raise ValueError("must have min or max, not equal")
        return value


def find_decided_objective(
    section: UntilSection | None, root: Any, evaluators: Sequence[Entry], problems: Problems
) -> Objective | None:
    """Return what adding repeats is to decide; None if nothing, or, with a problem, if it is invalid."""
    if section is None:
        return None
    where = ("run", "until", "decided")
    objective = find_objective(section.decided, evaluators, where, problems)
    if objective is None:
        return None
    if isinstance(plain_value(root["run"]["until"]["decided"]), str) and objective.metric.role != "success":
        message = f"{objective.metric.name} is not a success metric; give it a limit: {{metric: NAME, max: NUMBER}}"
        problems.add(where, message)
        return None
    if repeats_of(objective.evaluator.title, evaluators) < 2:
        problems.add(
            where, f"evaluator {objective.evaluator.title} has one repeat; set the most repeats that may be run"
        )
        return None
    return objective


def repeats_of(title: str, evaluators: Sequence[Entry]) -> int:
    """Return how many repeats an evaluator's setting has; 1 if it cannot be used here."""
    for entry in evaluators:
        if entry.setting.title == title and entry.description is not None:
            return max(1, len(entry.description.identities))
    return 1
