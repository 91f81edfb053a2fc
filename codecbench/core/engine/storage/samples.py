"""Measurements of a cell: checked as they are yielded, and stored per frame as a small Parquet file."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.evaluator import Evaluator, Measurement
from codecbench.core.engine.text import clean_line

if TYPE_CHECKING:
    import pyarrow


class MeasurementError(CodecbenchError):
    """Raised if an evaluator yields something that is not a measurement of a metric that it declared."""


MOST_WITHOUT_FRAME: Final = 5_000
MOST_A_FRAME: Final = 1_000
MOST_OF_FRAMES: Final = 1_000_000
MOST_STAGES: Final = 1_000
"""Limits in one cell, because tables with more would take minutes.

They are numbers of measurements without a frame, per frame, and of frames in total, and of stages of one metric.
"""


class MeasurementCheck:
    """Checks what an evaluator yields in a cell against what it declared, and limits how much."""

    def __init__(self, evaluator: Evaluator[Any], frames: int) -> None:
        self._metrics = {metric.name for metric in evaluator.metrics}
        self._stages: dict[str, set[str | None]] = {name: set() for name in self._metrics}
        self._frames = frames
        self._most_of_frames = min(MOST_A_FRAME * frames, MOST_OF_FRAMES)
        self._without_frame = self._of_frames = 0

    def check(self, measurements: Iterable[Measurement], frame: int | None = None) -> Iterator[Measurement]:
        """Yield the measurements, with `frame` filled in if given. Raises MeasurementError at the first invalid one."""
        for measurement in measurements:
            yield self._check_one(measurement, frame)

    def _check_one(self, measurement: object, frame: int | None) -> Measurement:
        if not isinstance(measurement, Measurement):
            raise MeasurementError(f"yielded {type(measurement).__name__}; evaluators yield Measurement")
        name, value = measurement.metric, measurement.value
        if name not in self._metrics:
            raise MeasurementError(f"metric {name!r} is not declared; declared: {', '.join(sorted(self._metrics))}")
        if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
            raise MeasurementError(f"{name}: a value is a number, got {type(value).__name__}")
        if math.isnan(value) and not measurement.reason:
            raise MeasurementError(f"{name}: NaN without a reason; a missing value needs one")
        for text in (measurement.stage, measurement.reason):
            if text is not None and not isinstance(text, str):
                raise MeasurementError(f"{name}: stage and reason are text, got {type(text).__name__}")
        if frame is None:
            frame = measurement.frame
        elif measurement.frame not in (None, frame):
            raise MeasurementError(f"{name}: measured on frame {frame} but yielded for frame {measurement.frame}")
        if frame is not None and not (isinstance(frame, int | np.integer) and 0 <= frame < self._frames):
            raise MeasurementError(f"{name}: frame {frame!r} is not one of 0..{self._frames - 1}")
        self._count(name, measurement.stage, frame)
        stage, reason = (None if text is None else clean_line(text) for text in (measurement.stage, measurement.reason))
        return Measurement(name, float(value), None if frame is None else int(frame), stage, reason)

    def _count(self, name: str, stage: str | None, frame: int | None) -> None:
        """Raise MeasurementError if a cell has more measurements than a table should have to show."""
        self._without_frame += frame is None
        self._of_frames += frame is not None
        self._stages[name].add(stage)
        if self._without_frame > MOST_WITHOUT_FRAME:
            raise MeasurementError(f"{name}: more than {MOST_WITHOUT_FRAME:,} measurements that belong to no frame")
        if self._of_frames > self._most_of_frames:
            raise MeasurementError(
                f"{name}: more than {self._most_of_frames:,} measurements of frames in one cell; at most "
                f"{MOST_A_FRAME:,} for each of its {self._frames:,} frames, and {MOST_OF_FRAMES:,} in all"
            )
        if len(self._stages[name]) > MOST_STAGES:
            raise MeasurementError(f"{name}: more than {MOST_STAGES:,} stages")


def parquet_from_samples(samples: list[Measurement]) -> bytes:
    """Return per-frame measurements as a Parquet file: metric, frame, stage, value, reason, in the given order.

    The columns are built from buffers, because `pyarrow.array` imports pandas: half a second in every worker.
    """
    import pyarrow as pa  # slow, and most commands do not need it
    import pyarrow.parquet as pq

    values = np.array([sample.value for sample in samples], np.float64)
    table = pa.table(
        {
            "metric": _text_column([sample.metric for sample in samples]),
            "frame": _integer_column([sample.frame for sample in samples]),
            "stage": _text_column([sample.stage for sample in samples]),
            "value": pa.Array.from_buffers(pa.float64(), len(values), [None, pa.py_buffer(values)]),
            "reason": _text_column([sample.reason for sample in samples]),
        }
    )
    sink = pa.BufferOutputStream()
    pq.write_table(table, sink, compression="zstd")
    return bytes(sink.getvalue())


def _integer_column(values: list[int | None]) -> pyarrow.Array:
    """Return a column of integers from 0, with None as null."""
    import pyarrow as pa

    filled = np.array([-1 if value is None else value for value in values], np.int32)
    valid = np.packbits(filled >= 0, bitorder="little")
    return pa.Array.from_buffers(pa.int32(), len(filled), [pa.py_buffer(valid), pa.py_buffer(filled)])


def _text_column(values: list[str | None]) -> pyarrow.DictionaryArray:
    """Return a dictionary-encoded column of texts, with None as null."""
    import pyarrow as pa

    places = {text: place for place, text in enumerate(dict.fromkeys(text for text in values if text is not None))}
    words = [text.encode() for text in places]
    ends = np.cumsum([0, *map(len, words)], dtype=np.int32)
    dictionary = pa.StringArray.from_buffers(len(words), pa.py_buffer(ends), pa.py_buffer(b"".join(words)))
    indices = _integer_column([None if text is None else places[text] for text in values])
    return pa.DictionaryArray.from_arrays(indices, dictionary)


def table_from_parquet(content: bytes) -> pyarrow.Table:
    """Read the columns that `parquet_from_samples` wrote. Raises ValueError or OSError for anything else."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    file = pq.ParquetFile(pa.BufferReader(content))
    if file.metadata.num_rows > MOST_OF_FRAMES:
        raise ValueError(f"it has {file.metadata.num_rows:,} rows; a cell has at most {MOST_OF_FRAMES:,}")
    table = file.read(use_threads=False)
    if table.schema.names != ["metric", "frame", "stage", "value", "reason"]:
        raise ValueError(f"its columns are {', '.join(table.schema.names)}")
    return table


def json_from_value(value: float) -> float | str | None:
    """Convert a value to JSON: infinities become text, NaN becomes null."""
    if math.isfinite(value):
        return value
    return None if math.isnan(value) else ("inf" if value > 0 else "-inf")


def value_from_json(value: float | str | None) -> float:
    """Read the value that `json_from_value` wrote."""
    return math.nan if value is None else float(value)


def json_from_measurement(measurement: Measurement) -> list[Any]:
    """Return [metric, value, stage, reason] of a measurement that belongs to no frame."""
    return [measurement.metric, json_from_value(measurement.value), measurement.stage, measurement.reason]


def measurement_from_json(row: list[Any]) -> Measurement:
    """Read the measurement that `json_from_measurement` wrote."""
    metric, value, stage, reason = row
    stage, reason = (None if text is None else clean_line(text) for text in (stage, reason))
    return Measurement(clean_line(metric), value_from_json(value), None, stage, reason)
