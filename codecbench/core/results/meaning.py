"""What a run's plugins declared of their meaning: from its plan, or from what is installed where the plan lacks it."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from pydantic import TypeAdapter

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.evaluator import Evaluator
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import View
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.registry import Registry

log = logging.getLogger("codecbench.results")


@dataclass(frozen=True)
class Meaning:
    """metrics, views: by the title of an evaluator's setting. baselines, anchors: names of codecs."""

    metrics: Mapping[str, Mapping[str, Metric]]
    views: Mapping[str, tuple[View, ...]]
    baselines: frozenset[str] = frozenset()
    anchors: frozenset[str] = frozenset()


def meaning_of(plan: Plan, evaluators: Mapping[str, Evaluator[Any]], registry: Registry) -> Meaning:
    """The meaning of a run. evaluators: instances by title, as far as they are installed.

    What the plan says comes first, so that a run folder reads the same wherever it is opened.
    """
    metrics: dict[str, dict[str, Metric]] = {}
    views: dict[str, tuple[View, ...]] = {}
    for title in dict.fromkeys(cell.evaluator.title for cell in plan.cells):
        stored = plan.declared.get("evaluators", {}).get(title, {})
        here = evaluators.get(title)
        known = [_read(Metric, value) for value in _listed(stored, "metrics")] + list(here.metrics if here else ())
        metrics[title] = {}
        for metric in filter(None, known):
            metrics[title].setdefault(metric.name, metric)
        drawn = [view for value in _listed(stored, "views") if (view := _read(View, value))]
        views[title] = tuple(drawn) if stored else tuple(here.views if here else ())
    references = {name: _reference(name, plan, registry) for name in dict.fromkeys(c.codec.name for c in plan.cells)}
    return Meaning(
        metrics,
        views,
        frozenset(name for name, reference in references.items() if reference == "baseline"),
        frozenset(name for name, reference in references.items() if reference == "anchor"),
    )


def _reference(name: str, plan: Plan, registry: Registry) -> str:
    stored = plan.declared.get("codecs", {}).get(name)
    if stored is not None:
        return str(stored.get("reference", ""))
    try:
        return str(registry.load("codec", name).reference)
    except CodecbenchError:
        return ""


def _listed(stored: dict[str, Any], name: str) -> list[dict[str, Any]]:
    found = stored.get(name)
    return [value for value in found if isinstance(value, dict)] if isinstance(found, list) else []


def _read(kind: type[Any], value: dict[str, Any]) -> Any:
    """A metric or view as the plan keeps it; None, with a line in the log, where this version cannot read it."""
    names = {field.name for field in fields(kind)}
    known = {key: part for key, part in value.items() if key in names}
    try:
        return TypeAdapter(kind).validate_python(known)
    except (CodecbenchError, ValueError) as error:
        log.warning("plan.json: %s", " ".join(str(error).split()))
        return None
