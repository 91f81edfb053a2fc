"""Store in the plan, as JSON types, what plugins declare about themselves, so that tables need no plugin."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any, Final

from pydantic import TypeAdapter

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.evaluator import Evaluator
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import View
from codecbench.core.engine.planning.model import Plan, PluginSetting

_OFFERED: Final = ("compare", "drawing", "marks")
"""Optional methods of an evaluator that reports call."""

log = logging.getLogger("codecbench.results")


def codec_declaration(codec: AnyCodec[Any]) -> dict[str, Any]:
    """Return what a codec declares."""
    return {"reference": codec.reference, "stateless": codec.stateless}


def evaluator_declaration(evaluator: Evaluator[Any]) -> dict[str, Any]:
    """Return what an evaluator's setting declares."""
    return {
        "metrics": [_json(metric) for metric in evaluator.metrics],
        "views": [_json(view) for view in evaluator.views],
        "typical_ms_per_frame": evaluator.typical_ms_per_frame,
        "offers": [name for name in _OFFERED if getattr(type(evaluator), name) is not getattr(Evaluator, name)],
    }


def offers_of(plan: Plan, evaluator: PluginSetting) -> Sequence[str]:
    """Return which optional methods an evaluator has according to the plan; all of them if the plan does not say."""
    offers = plan.declared.get("evaluators", {}).get(evaluator.title, {}).get("offers")
    return offers if isinstance(offers, list) else _OFFERED


def _json(part: Metric | View) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(part).items()}


def read_declaration(kind: type[Any], value: dict[str, Any]) -> Any:
    """Read a metric or view from the plan; if this version cannot, log a warning and return None."""
    names = {field.name for field in fields(kind)}
    new_names: dict[str, str] = getattr(kind, "__former_names__", {})
    values = {new_names.get(key, key): part for key, part in value.items() if new_names.get(key, key) in names}
    try:
        return TypeAdapter(kind).validate_python(values)
    except (CodecbenchError, ValueError) as error:
        log.warning("plan.json: %s", " ".join(str(error).split()))
        return None
