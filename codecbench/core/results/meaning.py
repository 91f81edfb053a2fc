"""What a run's plugins declared of their meaning: from its plan, or from what is installed where the plan lacks it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import View
from codecbench.core.engine.planning.declared import read_declared
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.registry import Registry
from codecbench.core.results.hosted_evaluator import ResultsEvaluator


@dataclass(frozen=True)
class Meaning:
    """metrics, views: by the title of an evaluator's setting. baselines, anchors: names of codecs."""

    metrics: Mapping[str, Mapping[str, Metric]]
    views: Mapping[str, tuple[View, ...]]
    baselines: frozenset[str] = frozenset()
    anchors: tuple[str, ...] = ()


def meaning_of(plan: Plan, evaluators: Mapping[str, ResultsEvaluator], registry: Registry) -> Meaning:
    """The meaning of a run. evaluators: instances by title, as far as they are installed.

    What the plan says comes first, so that a run folder reads the same wherever it is opened.
    """
    metrics: dict[str, dict[str, Metric]] = {}
    views: dict[str, tuple[View, ...]] = {}
    for title in dict.fromkeys(cell.evaluator.title for cell in plan.cells):
        stored = plan.declared.get("evaluators", {}).get(title, {})
        here = evaluators.get(title)
        known = [read_declared(Metric, value) for value in _listed(stored, "metrics")]
        known += list(here.metrics if here else ())
        metrics[title] = {}
        for metric in filter(None, known):
            metrics[title].setdefault(metric.name, metric)
        drawn = [view for value in _listed(stored, "views") if (view := read_declared(View, value))]
        views[title] = tuple(drawn) if stored else tuple(here.views if here else ())
    references = {name: _reference(name, plan, registry) for name in dict.fromkeys(c.codec.name for c in plan.cells)}
    return Meaning(
        metrics,
        views,
        frozenset(name for name, reference in references.items() if reference == "baseline"),
        tuple(name for name, reference in references.items() if reference == "anchor"),
    )


def _reference(name: str, plan: Plan, registry: Registry) -> str:
    stored = plan.declared.get("codecs", {}).get(name)
    if stored is not None:
        return str(stored.get("reference", ""))
    try:
        return str(registry.ask(reference_of, name, of=[("codec", name)]))
    except CodecbenchError:
        return ""


def _listed(stored: dict[str, Any], name: str) -> list[dict[str, Any]]:
    found = stored.get(name)
    return [value for value in found if isinstance(value, dict)] if isinstance(found, list) else []


def reference_of(registry: Registry, name: str) -> str:
    """What a codec is to others."""
    return str(registry.load("codec", name).reference)
