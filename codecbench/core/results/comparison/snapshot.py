"""What a comparison needs of a run, small enough to keep beside the code as a baseline."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter

from codecbench.core.contracts.errors import StoreError
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.foreign_text import clean_line, clean_value
from codecbench.core.engine.identity import json_from_bytes
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.results.collect import open_run
from codecbench.core.results.export import json_value
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.table import CellResult

FORMAT: Final = 1


@dataclass(frozen=True)
class Series:
    """One metric of one sequence, codec setting and evaluator: a value for each repeat, in order.

    Per-frame metrics are aggregated by the first aggregate that the metric declares. status and reason: of the
    first repeat that is not `ok`. fingerprint: of the sequence. repeatable: equal code gives equal values. unit,
    confirmed_by, in_units_of: as the metric declares; empty in baseline files of earlier versions.
    """

    sequence: str
    codec: str
    setting: str
    evaluator: str
    metric: str
    better: str
    repeatable: bool
    values: tuple[float, ...]
    status: str
    reason: str
    fingerprint: str
    unit: str = ""
    confirmed_by: str = ""
    in_units_of: str = ""

    @property
    def key(self) -> tuple[str, str, str, str, str]:
        return self.sequence, self.codec, self.setting, self.evaluator, self.metric


@dataclass(frozen=True)
class Snapshot:
    """All series of a run and the machines that made them."""

    name: str
    machines: tuple[str, ...]
    series: tuple[Series, ...]


_SERIES: Final = TypeAdapter(Series)
_SNAPSHOT: Final = TypeAdapter(Snapshot)


def snapshot_of(run: RunResult) -> Snapshot:
    """The series of a run. A metric of a part (`encode.dct`) is a series of its own."""
    cells: dict[tuple[str, str, str, str], list[CellResult]] = defaultdict(list)
    for result in run.results:
        cell = result.cell
        cells[cell.sequence.name, cell.codec.name, cell.codec.label, cell.evaluator.title].append(result)
    series = tuple(series for members in cells.values() for series in _series(members))
    return Snapshot(run.plan.name, tuple(sorted(map(_machine, run.environments.values()))), series)


def _series(members: list[CellResult]) -> list[Series]:
    members = sorted(members, key=lambda result: result.cell.repeat)
    bad = next((result for result in members if result.status != "ok"), None)
    cell = members[0].cell
    values: dict[str, list[float]] = defaultdict(list)
    metrics = {name: metric for result in members for name, metric in result.metrics.items()}
    for result in members:
        for (name, stage, how), value in result.summaries.items():
            if name in metrics and how == metrics[name].aggregates[0]:
                values[f"{name}.{stage}" if stage else name].append(value)
        for measured in result.measurements:
            name = f"{measured.metric}.{measured.stage}" if measured.stage else measured.metric
            values[name].append(measured.value)
    if not values:
        values["status"] = []
    found = []
    for name, numbers in values.items():
        metric_name, _, stage = name.partition(".")
        metric = metrics.get(metric_name) or Metric(metric_name, "", "neither", "")
        confirmed_by = f"{metric.confirmed_by}.{stage}" if metric.confirmed_by and stage else metric.confirmed_by
        found.append(
            Series(
                cell.sequence.name, cell.codec.name, cell.codec.label, cell.evaluator.title, name,
                metric.better, metric.repeatable, tuple(numbers),
                bad.status if bad else "ok", bad.reason if bad else "", cell.sequence.fingerprint,
                metric.unit, confirmed_by, metric.in_units_of,
            )
        )  # fmt: skip
    return found


def _machine(environment: dict[str, Any]) -> str:
    machine = environment.get("machine", {})
    return f"{machine.get('cpu')}, {machine.get('cores')} cores, {environment.get('volatile', {}).get('host')}"


def write_snapshot(snapshot: Snapshot, path: Path) -> None:
    """Keep a snapshot as JSON, one line a series, so that version control shows what changed."""
    lines = [
        json.dumps({**asdict(series), "values": [json_value(value) for value in series.values]})
        for series in snapshot.series
    ]
    head = json.dumps({"format": FORMAT, "name": snapshot.name, "machines": snapshot.machines})
    write_file(path, ("\n".join([head, *lines]) + "\n").encode())


def read_snapshot(path: Path) -> Snapshot:
    """The snapshot in a file, or of the run in a folder. Raises StoreError for anything else."""
    if path.is_dir():
        return snapshot_of(open_run(path))
    try:
        head, *lines = path.read_text().splitlines()
        facts = clean_value(json_from_bytes(head))
        if facts["format"] != FORMAT:
            raise ValueError(f"it has format {facts['format']}, this version reads {FORMAT}")
        series = tuple(_read(clean_value(json_from_bytes(line))) for line in lines)
        return _SNAPSHOT.validate_python({"name": facts["name"], "machines": facts["machines"], "series": series})
    except FileNotFoundError:
        raise StoreError(f"{path} is neither a run folder nor a baseline file") from None
    except (ValueError, KeyError, TypeError) as error:
        reason = clean_line(str(error))
        raise StoreError(f"{path} is not a baseline that `codecbench compare --save` wrote: {reason}") from error


def _read(value: dict[str, Any]) -> Series:
    numbers = tuple(float("nan") if number is None else float(number) for number in value["values"])
    return _SERIES.validate_python({**value, "values": numbers})
