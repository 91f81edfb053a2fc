"""What plugins declare of their meaning, as JSON types: kept in the plan, so that tables need no plugin."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.evaluator import Evaluator
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import View


def codec_declared(codec: Codec[Any]) -> dict[str, Any]:
    """The meaning of a codec."""
    return {"reference": codec.reference}


def evaluator_declared(evaluator: Evaluator[Any]) -> dict[str, Any]:
    """The meaning of an evaluator's setting."""
    return {
        "metrics": [_json(metric) for metric in evaluator.metrics],
        "views": [_json(view) for view in evaluator.views],
        "typical_ms_per_frame": evaluator.typical_ms_per_frame,
    }


def _json(part: Metric | View) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(part).items()}
