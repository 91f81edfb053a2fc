"""What evaluators await: values that another evaluator of the matrix measures, and that stand for a parameter."""

from __future__ import annotations

from collections.abc import Sequence

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.declared import read_declared
from codecbench.core.engine.planning.description import InvalidParams, describe
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.objective import metrics_of
from codecbench.core.engine.planning.yaml_file import Problems
from codecbench.core.engine.plugins.registry import Registry


def sources(quantity: str, evaluators: Sequence[Entry]) -> list[tuple[Entry, Metric]]:
    """The evaluators that measure something and await nothing themselves, each with its metric."""
    found = ((entry, metric) for entry in evaluators if not entry.requires for metric in metrics_of(entry))
    return [(entry, metric) for entry, metric in found if metric.quantity == quantity]


def require_sources(evaluators: Sequence[Entry], registry: Registry, problems: Problems) -> None:
    """Note a problem with every parameter that awaits what none of the evaluators measures, or several do."""
    for entry in evaluators:
        for parameter, quantity in entry.requires.items():
            found = [source.setting.title for source, _ in sources(quantity, evaluators)]
            if len(found) == 1:
                continue
            value, place = entry.setting.params.get(parameter), (*entry.where, "params", parameter)
            if found:
                message = f"{value!r} is the time of {quantity}, which several evaluators measure"
                message += f": {', '.join(found)}; keep one of them, or give milliseconds"
            else:
                known = " or ".join(_measuring(quantity, registry)) or "one that does"
                message = f"{value!r} is the time of {quantity}, which no evaluator of this matrix measures"
                message += f"; add {known}, or give milliseconds"
            problems.add(place, message)


def _measuring(quantity: str, registry: Registry) -> list[str]:
    """Installed evaluators that measure something with their usual parameters."""
    names = []
    for plugin in registry.plugins("evaluator"):
        try:
            declared = describe(registry, "evaluator", plugin.spec.name, {}).declared
        except (CodecbenchError, InvalidParams):
            continue
        metrics = (read_declared(Metric, value) for value in declared.get("metrics", ()))
        if any(metric is not None and metric.quantity == quantity for metric in metrics):
            names.append(plugin.spec.name)
    return names
