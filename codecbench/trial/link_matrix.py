"""A matrix with what it takes to choose a setting over a link."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from codecbench.core.analysis.choosing import Demand
from codecbench.core.contracts.errors import MatrixError
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.matrix import Matrix, matrix_from, read_matrix
from codecbench.core.engine.planning.objective import metrics_of, repeats_of
from codecbench.core.engine.planning.yaml_file import yaml_text
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.simulation.settings import LinkSettings

_REPEATS: Final = 20
"""Of what is cheap: enough to tell a success rate of four fifths from one half."""
_STARTS: Final = tuple(range(16))
"""Of SLAM, which takes its time: of these as many are run as decide."""
_FEWEST: Final = 4
"""Repeats below which nothing can be decided."""


@dataclass(frozen=True)
class LinkMatrix:
    """matrix: to be run. demand: what is asked of the run. added: what the matrix did not have, in words."""

    matrix: Matrix
    demand: Demand
    added: tuple[str, ...]


def link_matrix(source: Path | Mapping[str, Any], demand: Demand, registry: Registry) -> LinkMatrix:
    """The matrix of a file, or a mapping, with evaluators that measure what is asked, where it has none.

    Those that are there over the link stay as they are, and what is added goes the same way. Where there are none, and
    a device is asked for, what encoding takes on it is simulated. Raises MatrixError for a wrong matrix and for a
    device beside another that the matrix simulates, and PluginError for a link that is not known.
    """
    registry.find("link", demand.link)
    folder = source.resolve().parent if isinstance(source, Path) else Path.cwd()
    given = read_matrix(source, registry) if isinstance(source, Path) else matrix_from(source, registry)
    over = [entry for entry in given.evaluators if _is_over(entry, demand.link)]
    if demand.device_factor is not None and any(entry.setting.params.get("encode_ms") for entry in over):
        message = "simulates the time of encoding with encode_ms already: set device_factor there and give none here"
        raise MatrixError(f"{given.path}: over {demand.link} it {message}")
    more = list(_missing(given, over, demand))
    root = given.root
    root["evaluators"].extend(more)
    simulates = not over and demand.device_factor is not None
    try:
        made = matrix_from(yaml_text(root), registry, folder) if more else given
    except MatrixError as error:
        names = ", ".join(item["use"] for item in more)
        message = (
            f"{given.path}: with {names} added for the link {demand.link} it is no longer sound; add them yourself"
        )
        raise MatrixError(f"{message}: {error}") from None
    added = [f"{item['use']} is added{_of_link(item)}" for item in more]
    decided = None if made.until or demand.error_m is None else _to_decide(made, demand)
    if decided is not None:
        root["run"] = {**(root.get("run") or {}), "until": {"decided": decided}}
        made = matrix_from(yaml_text(root), registry, folder)
        added.append(f"repeats are added until {decided['metric']} is known to be at most {demand.error_m:g} m or not")
    made = replace(made, name=given.name)
    return LinkMatrix(made, replace(demand, device_factor=None) if simulates else demand, tuple(added))


def _missing(given: Matrix, over: list[Entry], demand: Demand) -> Iterator[dict[str, Any]]:
    """Evaluators to be added."""
    usual = {} if demand.device_factor is None else {"encode_ms": "measured", "device_factor": demand.device_factor}
    ways = [_way(entry) for entry in over] or [usual]
    metrics = [metric for entry in given.evaluators for metric in metrics_of(entry)]
    if not any(metric.role == "rate" and metric.headline for metric in metrics):
        yield {"use": "stream", "params": {"joins": 0}}
    if demand.device_factor is not None and not any(metric.quantity == "encoding" for metric in metrics):
        yield {"use": "timing"}
    for place, way in enumerate(ways):
        if way in ways[:place]:
            continue
        there = {metric.quantity for entry in over if _way(entry) == way for metric in metrics_of(entry)}
        link = {"link": demand.link, **way}
        if demand.deadline_ms is not None and "delay" not in there:
            yield {"use": "delivery", "params": {**link, "repeats": _REPEATS}}
        if demand.error_m is not None and "error" not in there:
            yield {"use": "trajectory", "params": {**link, "start_offsets": list(_STARTS)}}


def _is_over(entry: Entry, link: str) -> bool:
    uses = entry.description.uses if entry.description else []
    return any(kind == "link" and name == link for kind, name, _ in uses)


def _way(entry: Entry) -> dict[str, Any]:
    """All about the link but its name that is not as usual."""
    explicit = entry.description.explicit if entry.description else []
    names = [name for name in explicit if name in LinkSettings.model_fields and name != "link"]
    return {name: entry.setting.params[name] for name in names}


def _of_link(item: Mapping[str, Any]) -> str:
    link = item.get("params", {}).get("link")
    return f" over {link}" if link else ""


def _to_decide(made: Matrix, demand: Demand) -> dict[str, Any] | None:
    """What is to be decided by adding repeats; None where none can be added."""
    for entry in made.evaluators:
        metric = _with_quantity(entry, "error")
        title = entry.setting.title
        if metric and _is_over(entry, demand.link) and repeats_of(title, made.evaluators) >= _FEWEST:
            return {"metric": f"{title}.{metric.name}", "max": demand.error_m}
    return None


def _with_quantity(entry: Entry, quantity: Quantity) -> Metric | None:
    return next((metric for metric in metrics_of(entry) if metric.quantity == quantity), None)
