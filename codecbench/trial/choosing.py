"""`codecbench.choose`: judge codec settings over a link, from a run or from a matrix extended for that."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from codecbench.core.analysis import collect
from codecbench.core.analysis.choosing import Candidate, Demand, candidates
from codecbench.core.contracts.errors import MatrixError, ParamsError
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.matrix import Matrix, matrix_from, read_matrix
from codecbench.core.engine.planning.objective import metrics_of, repeats_of
from codecbench.core.engine.planning.yaml_file import yaml_text
from codecbench.core.engine.plugins.registry import Registry, installed
from codecbench.core.rounds import running
from codecbench.core.simulation.settings import LinkSettings

MINUTES: Final = 10.0
"""Time within which additional repeats start."""
_MATRICES: Final = (".yaml", ".yml", ".json")


def is_matrix(source: str | Path | Mapping[str, Any]) -> bool:
    """Return whether the source is a matrix and not a run folder."""
    return isinstance(source, Mapping) or Path(source).is_file() or Path(source).suffix in _MATRICES


def choose(
    source: str | Path | Mapping[str, Any],
    *,
    link: str,
    deadline_ms: float | None = None,
    error_m: float | None = None,
    share: float = 0.95,
    device_factor: float | None = None,
    out: str | Path | None = None,
    workers: int | None = None,
    minutes: float = MINUTES,
) -> list[Candidate]:
    """Judge every codec setting over a link, in order of rate; with several sequences, those over all come first.

    source: a run folder, or a matrix as a file or a dict. A matrix is run first, as far as the answer needs it, with
    missing evaluators added. out, workers: as in `codecbench.run`. minutes: additional repeats start only within this
    time. deadline_ms, share: the maximum age of a frame, and the minimum fraction of frames within it. error_m: the
    maximum error. A matrix needs one of the two. device_factor: how many times slower the device encodes than the
    machine that timed it. Raises ParamsError if a matrix is given without a demand,
    CodecbenchError if nothing was measured, PluginError for an unknown link, MatrixError and StoreError.
    """
    demand = Demand(link, deadline_ms, error_m, share, device_factor)
    if not is_matrix(source):
        return candidates(collect.open_nonempty_run(Path(str(source))), demand)
    if deadline_ms is None and error_m is None:
        raise ParamsError("give deadline_ms, error_m or both")
    extended = link_matrix(source if isinstance(source, Mapping) else Path(source), demand, installed())
    summary = running.run_matrix(extended.matrix, out, workers=workers, minutes=minutes)
    return candidates(collect.open_nonempty_run(summary.folder), extended.demand)


_REPEATS: Final = 20
"""Repeats of cheap evaluators: enough to distinguish a success rate of 0.8 from 0.5."""
_STARTS: Final = tuple(range(16))
"""Start offsets of SLAM, which is slow; only as many run as the decision needs."""
_FEWEST: Final = 4
"""Repeats below which nothing can be decided."""


@dataclass(frozen=True)
class LinkMatrix:
    """A matrix extended by what a choice over a link needs."""

    matrix: Matrix
    demand: Demand
    """What the run has to meet."""
    added: tuple[str, ...]
    """Descriptions of what the matrix lacked."""


def link_matrix(source: Path | Mapping[str, Any], demand: Demand, registry: Registry) -> LinkMatrix:
    """Return the matrix of a file or mapping, with evaluators added for what the demand needs and it lacks.

    Its own evaluators over the link stay as they are, and added ones use the same link parameters. If it has none and
    the demand names a device, the device's encoding time is simulated. Raises MatrixError for a wrong matrix and for a
    device if the matrix simulates another, and PluginError for an unknown link.
    """
    registry.find("link", demand.link)
    folder = source.resolve().parent if isinstance(source, Path) else Path.cwd()
    given = read_matrix(source, registry) if isinstance(source, Path) else matrix_from(source, registry)
    over_link = [entry for entry in given.evaluators if _is_over(entry, demand.link)]
    if demand.device_factor is not None and any(entry.setting.params.get("encode_ms") for entry in over_link):
        message = "already simulates encoding time (encode_ms): set device_factor there and give none here"
        raise MatrixError(f"{given.path}: over {demand.link} it {message}")
    added_items = list(_missing_evaluators(given, over_link, demand))
    root = given.root
    root["evaluators"].extend(added_items)
    simulates = not over_link and demand.device_factor is not None
    try:
        made = matrix_from(yaml_text(root), registry, folder) if added_items else given
    except MatrixError as error:
        names = ", ".join(item["use"] for item in added_items)
        message = f"{given.path}: not valid with {names} added for the link {demand.link}; add them yourself"
        raise MatrixError(f"{message}: {error}") from None
    added = [f"{item['use']} is added{_of_link(item)}" for item in added_items]
    decided = None if made.until or demand.error_m is None else _decision(made, demand)
    if decided is not None:
        root["run"] = {**(root.get("run") or {}), "until": {"decided": decided}}
        made = matrix_from(yaml_text(root), registry, folder)
        added.append(f"repeats are added until it is decided if {decided['metric']} is at most {demand.error_m:g} m")
    made = replace(made, name=given.name)
    return LinkMatrix(made, replace(demand, device_factor=None) if simulates else demand, tuple(added))


def _missing_evaluators(given: Matrix, over_link: list[Entry], demand: Demand) -> Iterator[dict[str, Any]]:
    """Yield the evaluators to add."""
    usual = {} if demand.device_factor is None else {"encode_ms": "measured", "device_factor": demand.device_factor}
    routes = [_link_params(entry) for entry in over_link] or [usual]
    metrics = [metric for entry in given.evaluators for metric in metrics_of(entry)]
    if not any(metric.role == "rate" and metric.headline for metric in metrics):
        yield {"use": "stream", "params": {"joins": 0}}
    if demand.device_factor is not None and not any(metric.quantity == "encoding" for metric in metrics):
        yield {"use": "timing"}
    for place, route in enumerate(routes):
        if route in routes[:place]:
            continue
        there = {metric.quantity for entry in over_link if _link_params(entry) == route for metric in metrics_of(entry)}
        link = {"link": demand.link, **route}
        if demand.deadline_ms is not None and "delay" not in there:
            yield {"use": "delivery", "params": {**link, "repeats": _REPEATS}}
        if demand.error_m is not None and "error" not in there:
            yield {"use": "trajectory", "params": {**link, "start_offsets": list(_STARTS)}}


def _is_over(entry: Entry, link: str) -> bool:
    uses = entry.description.uses if entry.description else []
    return any(kind == "link" and name == link for kind, name, _ in uses)


def _link_params(entry: Entry) -> dict[str, Any]:
    """Return the explicit link parameters of an evaluator, except the link's name."""
    explicit = entry.description.explicit if entry.description else []
    names = [name for name in explicit if name in LinkSettings.model_fields and name != "link"]
    return {name: entry.setting.params[name] for name in names}


def _of_link(item: Mapping[str, Any]) -> str:
    link = item.get("params", {}).get("link")
    return f" over {link}" if link else ""


def _decision(made: Matrix, demand: Demand) -> dict[str, Any] | None:
    """Return what added repeats have to decide; None if no repeats can be added."""
    for entry in made.evaluators:
        metric = _with_quantity(entry, "error")
        title = entry.setting.title
        if metric and _is_over(entry, demand.link) and repeats_of(title, made.evaluators) >= _FEWEST:
            return {"metric": f"{title}.{metric.name}", "max": demand.error_m}
    return None


def _with_quantity(entry: Entry, quantity: Quantity) -> Metric | None:
    return next((metric for metric in metrics_of(entry) if metric.quantity == quantity), None)
