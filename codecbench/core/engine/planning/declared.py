"""What plugins declare of their meaning, as JSON types: kept in the plan, so that tables need no plugin."""

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
"""What results ask an evaluator for, where it has it."""

log = logging.getLogger("codecbench.results")


def codec_declaration(codec: AnyCodec[Any]) -> dict[str, Any]:
    """The meaning of a codec."""
    return {"reference": codec.reference, "stateless": codec.stateless}


def evaluator_declaration(evaluator: Evaluator[Any]) -> dict[str, Any]:
    """The meaning of an evaluator's setting."""
    return {
        "metrics": [_json(metric) for metric in evaluator.metrics],
        "views": [_json(view) for view in evaluator.views],
        "typical_ms_per_frame": evaluator.typical_ms_per_frame,
        "offers": [name for name in _OFFERED if getattr(type(evaluator), name) is not getattr(Evaluator, name)],
    }


def offers_of(plan: Plan, evaluator: PluginSetting) -> Sequence[str]:
    """Which of these the plan says that an evaluator has; all, where it does not say."""
    found = plan.declared.get("evaluators", {}).get(evaluator.title, {}).get("offers")
    return found if isinstance(found, list) else _OFFERED


def _json(part: Metric | View) -> dict[str, Any]:
    return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(part).items()}


def read_declaration(kind: type[Any], value: dict[str, Any]) -> Any:
    """A metric or view as the plan keeps it; None, with a line in the log, where this version cannot read it."""
    names = {field.name for field in fields(kind)}
    current: dict[str, str] = getattr(kind, "__former_names__", {})
    known = {current.get(key, key): part for key, part in value.items() if current.get(key, key) in names}
    try:
        return TypeAdapter(kind).validate_python(known)
    except (CodecbenchError, ValueError) as error:
        log.warning("plan.json: %s", " ".join(str(error).split()))
        return None
