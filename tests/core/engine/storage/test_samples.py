"""What evaluators may yield, and measurements on their way to disk and back."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.storage import samples
from codecbench.core.engine.storage.samples import (
    MeasurementCheck,
    MeasurementError,
    json_from_measurement,
    measurement_from_json,
    parquet_from_samples,
    table_from_parquet,
)


def checked(*measurements: Any, frame: int | None = None) -> list[Measurement]:
    """What passes the check of an evaluator of two metrics on three frames."""
    metrics = [Metric("size", "B", "lower", ""), Metric("error", "1", "lower", "")]
    evaluator = SimpleNamespace(metrics=metrics)
    return list(MeasurementCheck(evaluator, 3).check(measurements, frame))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("measurement", "frame", "message"),
    [
        (3.0, None, "yielded float; "),
        (Measurement("speed", 1.0), None, "'speed' .* error, size"),
        (Measurement("size", True), None, "size: .*got bool"),
        (Measurement("size", "3"), None, "size: .*got str"),  # type: ignore[arg-type]
        (Measurement("size", None), None, "size: .*got NoneType"),  # type: ignore[arg-type]
        (Measurement("size", math.nan), None, "size: NaN without"),
        (Measurement("size", math.nan, reason=""), None, "size: NaN without"),
        (Measurement("size", 1.0, stage=3), None, "size: stage .*got int"),  # type: ignore[arg-type]
        (Measurement("size", 1.0, reason=b"x"), None, "size: stage .*got bytes"),  # type: ignore[arg-type]
        (Measurement("size", 1.0, frame=2), 1, "size: .*frame 1 .*frame 2"),
        (Measurement("size", 1.0, frame=3), None, r"size: frame 3 .*0\.\.2"),
        (Measurement("size", 1.0, frame=-1), None, r"size: frame -1 .*0\.\.2"),
        (Measurement("size", 1.0, frame=1.0), None, r"size: frame 1\.0 .*0\.\.2"),  # type: ignore[arg-type]
        (Measurement("size", 1.0), 3, r"size: frame 3 .*0\.\.2"),
    ],
)
def test_what_is_no_measurement_of_a_declared_metric_is_refused(
    measurement: Any, frame: int | None, message: str
) -> None:
    with pytest.raises(MeasurementError, match=message):
        checked(measurement, frame=frame)


def test_measurements_pass_with_their_frame_and_as_plain_numbers() -> None:
    found = checked(
        Measurement("size", 3), Measurement("size", np.float32(0.5), np.int64(2)), Measurement("error", np.int16(4), 0)
    )
    assert found == [Measurement("size", 3.0), Measurement("size", 0.5, 2), Measurement("error", 4.0, 0)]
    assert [type(measurement.value) for measurement in found] == [float] * 3
    assert type(found[1].frame) is int
    assert checked(Measurement("size", 3.0), Measurement("size", 4.0, 0), frame=0) == [
        Measurement("size", 3.0, 0), Measurement("size", 4.0, 0),
    ]  # fmt: skip
    (missing,) = checked(Measurement("size", math.nan, 1, "de\x1bcode", "too\nfew"))
    assert (missing.frame, missing.stage, missing.reason) == (1, "de\\x1bcode", "too few")
    assert checked(Measurement("size", math.inf), Measurement("size", -math.inf)) == [
        Measurement("size", math.inf), Measurement("size", -math.inf),
    ]  # fmt: skip


def test_there_is_an_end_to_what_a_cell_may_measure(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each bound is reached and then passed by one; what belongs to frames and to none is counted apart."""
    monkeypatch.setattr(samples, "MOST_WITHOUT_FRAME", 4)
    monkeypatch.setattr(samples, "MOST_A_FRAME", 1)
    monkeypatch.setattr(samples, "MOST_STAGES", 2)
    alone, framed = Measurement("size", 1.0), Measurement("size", 1.0, 0)
    assert len(checked(*[alone] * 4, *[framed] * 3)) == 7
    with pytest.raises(MeasurementError, match=r"size: .* 4 .*no frame"):
        checked(*[alone] * 5)
    with pytest.raises(MeasurementError, match=r"size: .* 3 measurements .* 1 for"):
        checked(*[framed] * 4)
    monkeypatch.setattr(samples, "MOST_OF_FRAMES", 2)
    with pytest.raises(MeasurementError, match=r" 2 .* 1 for .* 3 frames, and 2 "):
        checked(*[framed] * 3)
    stages = [Measurement("size", 1.0, stage=stage) for stage in ("encode", "decode", "encode")]
    assert len(checked(*stages, Measurement("error", 1.0))) == 4
    with pytest.raises(MeasurementError, match=r"size: .* 2 stages"):
        checked(*stages, alone)


def test_the_bounds_are_those_that_the_documentation_names() -> None:
    assert (samples.MOST_WITHOUT_FRAME, samples.MOST_OF_FRAMES, samples.MOST_STAGES) == (5_000, 1_000_000, 1_000)
    assert samples.MOST_A_FRAME == 1_000


@pytest.mark.parametrize(
    ("measurement", "row"),
    [
        (Measurement("ate", 0.1 + 0.2), ["ate", 0.1 + 0.2, None, None]),
        (Measurement("ate", math.inf, None, "decode"), ["ate", "inf", "decode", None]),
        (Measurement("ate", -math.inf), ["ate", "-inf", None, None]),
        (Measurement("ate", 0.0, None, "", ""), ["ate", 0.0, "", ""]),
    ],
)
def test_a_measurement_is_a_row_of_json(measurement: Measurement, row: list[Any]) -> None:
    assert json_from_measurement(measurement) == row
    assert measurement_from_json(row) == measurement


def test_a_missing_value_is_null_and_text_is_cleaned_as_it_is_read() -> None:
    assert json_from_measurement(Measurement("ate", math.nan, None, None, "why"))[1] is None
    found = measurement_from_json(["a\x07te", None, "en\ncode", "w\x00hy"])
    assert math.isnan(found.value)
    assert (found.metric, found.frame, found.stage, found.reason) == ("a\\x07te", None, "en code", "w\\x00hy")


def test_samples_are_a_table_of_dictionary_text_and_plain_numbers() -> None:
    kept = [Measurement("size", 1.5, 0, "encode"), Measurement("size", math.nan, 1, None, "black")]
    table = table_from_parquet(parquet_from_samples(kept))
    text = pa.dictionary(pa.int32(), pa.string())
    assert table.schema.equals(
        pa.schema([("metric", text), ("frame", pa.int32()), ("stage", text), ("value", pa.float64()), ("reason", text)])
    )
    assert table["value"].null_count == 0
    assert table["stage"].null_count == 1
    metadata = pq.ParquetFile(pa.BufferReader(parquet_from_samples(kept))).metadata
    assert metadata.row_group(0).column(3).compression == "ZSTD"
    assert len(table_from_parquet(parquet_from_samples([]))) == 0


def test_another_table_is_refused() -> None:
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table({"metric": ["size"], "value": [1.0]}), sink)
    with pytest.raises(ValueError, match="are metric, value"):
        table_from_parquet(bytes(sink.getvalue()))
    with pytest.raises((ValueError, OSError)):
        table_from_parquet(b"no parquet")
