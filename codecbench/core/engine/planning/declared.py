"""What plugins declare of their meaning, as JSON types: kept in the plan, so that tables need no plugin."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from codecbench.core.contracts.evaluator import Evaluator
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import View


def declared(codecs: Iterable[Any], evaluators: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """Meaning of codecs by name, and of evaluator settings by what tables call them. None is passed over.

    codecs: instances. evaluators: titles of settings with their instances.
    """
    return {
        "codecs": {codec.name: {"reference": codec.reference} for codec in codecs if codec is not None},
        "evaluators": {title: _evaluator(instance) for title, instance in evaluators if instance is not None},
    }


def _evaluator(instance: Evaluator[Any]) -> dict[str, Any]:
    return {
        "metrics": [_json(metric) for metric in instance.metrics],
        "views": [_json(view) for view in instance.views],
        "typical_ms_per_frame": instance.typical_ms_per_frame,
    }


def _json(part: Metric | View) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(part).items()}
