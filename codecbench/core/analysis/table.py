"""The tables of a run: tidy, one row a measurement, and wide, one row a codec setting on a sequence."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import Drawing
from codecbench.core.engine.planning.model import Cell
from codecbench.core.engine.storage.aggregate import aggregate
from codecbench.core.engine.storage.samples import json_from_value
from codecbench.core.engine.text import clean_line

if TYPE_CHECKING:
    import pyarrow

TIDY_COLUMNS: Final = (
    "sequence", "codec", "setting", "evaluator", "metric", "unit",
    "frame", "stage", "repeat", "value", "status", "reason",
)  # fmt: skip
NOTES: Final = "notes"
"""The last column of both tables, if any setting of the run has notes."""

_TEXT: Final = ("sequence", "codec", "setting", "evaluator", "metric", "unit", "stage", "status", "reason", NOTES)
_OVER_REPEATS: Final = {"mean": "mean", "sum": "mean"}
"""Aggregate over repeats, by the aggregate over frames; the median for all others."""


@dataclass(frozen=True)
class CellResult:
    """A cell with its record."""

    cell: Cell
    status: str
    reason: str
    measurements: tuple[Measurement, ...]
    """Those of no single frame, with those that compare with the baseline codec."""
    summaries: dict[tuple[str, str, str], float]
    """Aggregates over the frames of this repeat, by (metric, stage, aggregate)."""
    metrics: dict[str, Metric]
    """As the evaluator declares them, by name."""
    samples: Callable[[], pyarrow.Table]
    """Reads the samples of single frames: a table of metric, frame, stage, value, reason."""
    folder: Path
    """Of the record and its artifacts."""
    duration_s: float = 0.0
    """Wall time of its evaluation; 0 if unknown."""
    drawing: Callable[[], Drawing | None] = lambda: None
    """Draws the cell, if its evaluator can."""
    code: dict[str, str] = field(default_factory=dict)
    """Fingerprints of its plugins, by label."""
    worker: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    traceback: str = ""

    @property
    def row(self) -> tuple[str, str, str]:
        """The row of the wide table that the cell belongs to: sequence, codec, setting."""
        return self.cell.sequence.name, self.cell.codec.name, self.cell.codec.label

    def frames(self) -> pd.DataFrame:
        """The samples of single frames: metric, frame, stage, value, reason."""
        frames: pd.DataFrame = self.samples().to_pandas()
        return frames

    def values_of_frames(self, metric: str, stage: str = "") -> NDArray[np.float64]:
        """(frames,) values of a metric by frame; NaN for frames without one."""
        import pyarrow.compute as pc  # slow to load, and many commands read no samples

        samples = self.samples()
        of_stage = pc.equal(samples["stage"], stage) if stage else pc.is_null(samples["stage"])
        rows = samples.filter(pc.and_(pc.equal(samples["metric"], metric), of_stage))
        values = np.full(self.cell.sequence.frames, np.nan)
        values[rows["frame"].to_numpy()] = rows["value"].to_numpy()
        return values


def by_row(results: Iterable[CellResult]) -> dict[tuple[str, str, str], list[CellResult]]:
    """The cells of each row of the wide table."""
    rows: dict[tuple[str, str, str], list[CellResult]] = defaultdict(list)
    for result in results:
        rows[result.row].append(result)
    return rows


def tidy(results: Iterable[CellResult]) -> pd.DataFrame:
    """All measurements, one a row, in the order of the plan; columns as in TIDY_COLUMNS, and NOTES if there are any.

    A cell without measurements is one row with its status and reason and no metric. Missing values are NaN with a
    reason. Text columns are categorical, so that millions of samples fit in memory.
    """
    results = list(results)
    noted = _notes(results)
    parts = [_rows(result) for result in results]
    if not parts:
        return pd.DataFrame({name: pd.Series(dtype="object") for name in TIDY_COLUMNS})
    columns: dict[str, Any] = {}
    if noted:
        for result, part in zip(results, parts, strict=True):
            part[NOTES] = (np.zeros(len(part["value"]), np.int32), [noted.get(result.row, "")])
    for name in (*TIDY_COLUMNS, NOTES) if noted else TIDY_COLUMNS:
        values = [part[name] for part in parts]
        columns[name] = _join_text(values) if name in _TEXT else np.concatenate(values)
    table = pd.DataFrame(columns)
    table["frame"] = table["frame"].astype("Int32")
    return table


def wide(results: Iterable[CellResult]) -> pd.DataFrame:
    """One row for each sequence and codec setting; columns `evaluator.metric[.stage].aggregate`.

    An aggregate is taken over the frames of each repeat, then the median over repeats (the mean for `mean` and
    `sum`). A metric measured once a repeat is aggregated over the repeats. `status` is `ok` if every cell of the row
    is, else it counts those that are not; `reason` is the first of their reasons. `notes` is a column only if there are
    any.
    """
    rows = by_row(results)
    noted = _notes(result for members in rows.values() for result in members)
    table = []
    for (sequence, codec, setting), members in rows.items():
        row: dict[str, Any] = {"sequence": sequence, "codec": codec, "setting": setting}
        row |= _status(members)
        row |= _summaries(members)
        if noted:
            row[NOTES] = noted.get((sequence, codec, setting), "")
        table.append(row)
    return pd.DataFrame(table, columns=_column_order(table))


def _notes(results: Iterable[CellResult]) -> dict[tuple[str, str, str], str]:
    """The notes of each row of the wide table, without repetitions; only rows with notes."""
    noted: dict[tuple[str, str, str], dict[str, None]] = defaultdict(dict)
    for result in results:
        if result.notes:
            noted[result.row] |= dict.fromkeys(result.notes)
    return {row: "; ".join(notes) for row, notes in noted.items()}


def _rows(result: CellResult) -> dict[str, Any]:
    """The tidy rows of one cell as columns; constant text is a single text until columns are joined."""
    samples = result.samples() if result.status == "ok" else None
    if samples is not None and not len(samples):
        samples = None
    measurements = result.measurements
    count = len(measurements) + (0 if samples is None else len(samples))
    cell = result.cell
    constants = {
        "sequence": cell.sequence.name,
        "codec": cell.codec.name,
        "setting": cell.codec.label,
        "evaluator": cell.evaluator.title,
        "status": result.status,
    }
    nothing, count = count == 0, max(count, 1)
    columns: dict[str, Any] = {name: (np.zeros(count, np.int32), [text]) for name, text in constants.items()}
    columns["repeat"] = np.full(count, cell.repeat, np.int32)
    if nothing:
        blank: tuple[np.ndarray, list[str]] = (np.full(1, -1, np.int32), [])
        columns |= {"metric": blank, "unit": blank, "stage": blank, "reason": _codes([result.reason or None])}
        return columns | {"frame": np.full(1, np.nan), "value": np.full(1, np.nan)}
    metric = _chain(_codes([measured.metric for measured in measurements]), samples, "metric")
    codes, names = metric
    columns["metric"] = metric
    columns["unit"] = (codes, [result.metrics[name].unit if name in result.metrics else "" for name in names])
    columns["stage"] = _chain(_codes([measured.stage for measured in measurements]), samples, "stage")
    columns["reason"] = _chain(_codes([measured.reason for measured in measurements]), samples, "reason")
    columns["frame"] = np.full(len(measurements), np.nan)
    columns["value"] = np.array([measured.value for measured in measurements], dtype=np.float64)
    if samples is not None:
        for name in ("frame", "value"):
            columns[name] = np.concatenate([columns[name], samples[name].to_numpy()])
    return columns


def _codes(texts: list[str | None]) -> tuple[np.ndarray, list[str]]:
    """Texts as positions in a list of distinct texts; -1 for none."""
    names: dict[str, int] = {}
    codes = [-1 if text is None else names.setdefault(text, len(names)) for text in texts]
    return np.array(codes, np.int32), list(names)


def _chain(
    first: tuple[np.ndarray, list[str]], samples: pyarrow.Table | None, column: str
) -> tuple[np.ndarray, list[str]]:
    """Append a text column of the frames' samples to other texts."""
    if samples is None:
        return first
    codes, names = first
    texts = samples[column].combine_chunks().dictionary_encode()
    more = texts.indices.fill_null(-1).to_numpy()
    shifted = np.where(more < 0, -1, more + len(names)).astype(np.int32)
    return np.concatenate([codes, shifted]), names + [clean_line(text) for text in texts.dictionary.to_pylist()]


def _join_text(parts: list[tuple[np.ndarray, list[str]]]) -> pd.Categorical:
    names: dict[str, int] = {}
    joined = []
    for codes, texts in parts:
        lookup = np.array([names.setdefault(text, len(names)) for text in texts] + [-1], np.int32)
        joined.append(lookup[codes])
    return pd.Categorical.from_codes(np.concatenate(joined), categories=pd.Index(list(names), dtype=object))


def _status(members: list[CellResult]) -> dict[str, str]:
    """The status and the reason of a row."""
    bad = [member for member in members if member.status != "ok"]
    if not bad:
        return {"status": "ok", "reason": ""}
    counts = Counter(f"{member.cell.evaluator.title} {member.status}" for member in bad)
    status = ", ".join(word if count == 1 else f"{word} ({count} repeats)" for word, count in counts.items())
    return {"status": status, "reason": bad[0].reason}


def _summaries(members: list[CellResult]) -> dict[str, float]:
    """The wide columns of one row."""
    by_evaluator: dict[str, list[CellResult]] = defaultdict(list)
    for member in members:
        if member.status == "ok":
            by_evaluator[member.cell.evaluator.title].append(member)
    columns: dict[str, float] = {}
    for evaluator, repeats in by_evaluator.items():
        for name, value in _over_repeats(repeats):
            columns[f"{evaluator}.{name}"] = value
    return columns


def _over_repeats(repeats: list[CellResult]) -> Iterator[tuple[str, float]]:
    metrics = {name: metric for repeat in repeats for name, metric in repeat.metrics.items()}
    per_repeat: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    single: dict[tuple[str, str], list[float]] = defaultdict(list)
    for repeat in repeats:
        for key, value in repeat.summaries.items():
            per_repeat[key].append(value)
        for measured in repeat.measurements:
            single[measured.metric, measured.stage or ""].append(measured.value)
    for (name, stage, how), values in per_repeat.items():
        yield _column(name, stage, how), _of_repeats(_OVER_REPEATS.get(how, "median"), values)
    for (name, stage), values in single.items():
        for how in metrics[name].aggregates if name in metrics else ("mean",):
            if len(values) > 1 or how in ("mean", "median"):
                yield _column(name, stage, how), _of_repeats(how, values)


def _of_repeats(how: str, values: list[float]) -> float:
    """An aggregate of one value a repeat; a single value is its own."""
    return values[0] if len(values) == 1 else aggregate(how, np.array(values))


def _column(metric: str, stage: str, how: str) -> str:
    return f"{metric}.{stage}.{how}" if stage else f"{metric}.{how}"


def _column_order(rows: list[dict[str, Any]]) -> list[str]:
    """Every column of any row, in order of first appearance, with the status last."""
    seen = dict.fromkeys(("sequence", "codec", "setting", *(name for row in rows for name in row)))
    tail = ("status", "reason", NOTES) if NOTES in seen else ("status", "reason")
    return [*(name for name in seen if name not in tail), *tail]


def json_value(value: object) -> object:
    """Convert a value to what JSON can hold: infinities to text, NaN to null."""
    return json_from_value(value) if isinstance(value, float) else value
