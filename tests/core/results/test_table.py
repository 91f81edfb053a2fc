"""Tables from cells with known values, and aggregates against numpy."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.aggregate import AGGREGATES, aggregate, median_interval, summarise
from codecbench.core.engine.planning.model import Cell, PluginSetting, SequenceEntry
from codecbench.core.engine.storage.samples import parquet_from_samples, table_from_parquet
from codecbench.core.results.table import TIDY_COLUMNS, CellResult, tidy, wide

SEQUENCE = SequenceEntry("room", PluginSetting("dataset", "synthetic", "1"), "f00d", 3, 3, True, True)
PSNR = Metric("psnr_db", "dB", "higher", "a test", aggregates=("mean", "median"))
ATE = Metric("ate_m", "m", "lower", "a test", aggregates=("median", "iqr"))


def result(
    codec: str = "jpeg",
    label: str = "quality=10",
    repeat: int = 0,
    *,
    status: str = "ok",
    reason: str = "",
    psnr: tuple[float, ...] = (),
    own: tuple[Measurement, ...] = (),
) -> CellResult:
    cell = Cell(
        id=f"{codec}{label}{repeat}",
        sequence=SEQUENCE,
        codec=PluginSetting("codec", codec, "1", {}, label),
        evaluator=PluginSetting("evaluator", "test", "1"),
        repeat=repeat,
        seed=0,
        exclusive=False,
        job_id=None,
    )
    samples = [Measurement("psnr_db", value, frame=index) for index, value in enumerate(psnr)]
    kept = table_from_parquet(parquet_from_samples(samples))
    metrics = {"psnr_db": PSNR, "ate_m": ATE}
    return CellResult(cell, status, reason, own, summarise(samples, [PSNR]), metrics, lambda: kept, Path())


def test_tidy_has_one_row_a_measurement_and_the_columns_in_order() -> None:
    table = tidy([result(psnr=(30.0, 31.0), own=(Measurement("ate_m", 0.5, stage="decode"),))])
    assert tuple(table.columns) == TIDY_COLUMNS
    assert table["metric"].tolist() == ["ate_m", "psnr_db", "psnr_db"]
    assert table["unit"].tolist() == ["m", "dB", "dB"]
    assert table["value"].tolist() == [0.5, 30.0, 31.0]
    assert table["frame"].isna().tolist() == [True, False, False]
    assert table["stage"].astype(object).where(table["stage"].notna(), None).tolist() == ["decode", None, None]
    assert set(table["status"]) == {"ok"}


def test_a_failed_cell_is_a_row_without_a_number() -> None:
    table = tidy([result(psnr=(30.0,)), result(label="quality=50", status="crashed", reason="SIGSEGV")])
    row = table.iloc[1]
    assert (row["status"], row["reason"]) == ("crashed", "SIGSEGV")
    assert math.isnan(row["value"])
    assert pd.isna(row["metric"])


def test_missing_values_keep_their_reason() -> None:
    table = tidy([result(own=(Measurement("ate_m", math.nan, reason="never initialised"),))])
    assert math.isnan(table["value"][0])
    assert table["reason"][0] == "never initialised"
    assert table["status"][0] == "ok"


def test_no_cells_give_an_empty_table_with_the_columns() -> None:
    assert tuple(tidy([]).columns) == TIDY_COLUMNS
    assert len(wide([])) == 0


def test_wide_aggregates_over_frames_and_then_over_repeats() -> None:
    cells = [result(repeat=0, psnr=(30.0, 32.0, 40.0)), result(repeat=1, psnr=(20.0, 21.0, 25.0))]
    row = wide(cells).iloc[0]
    assert row["test.psnr_db.mean"] == pytest.approx(np.mean([34.0, 22.0]))
    assert row["test.psnr_db.median"] == pytest.approx(np.median([32.0, 21.0]))
    assert row["status"] == "ok"


def test_wide_aggregates_single_values_over_repeats() -> None:
    cells = [result(repeat=index, own=(Measurement("ate_m", value),)) for index, value in enumerate((1.0, 2.0, 9.0))]
    row = wide(cells).iloc[0]
    assert row["test.ate_m.median"] == 2.0
    assert row["test.ate_m.iqr"] == pytest.approx(np.subtract(*np.percentile([1, 2, 9], [75, 25])))


def test_wide_says_what_failed_and_keeps_the_rest() -> None:
    cells = [result(psnr=(30.0,)), result(repeat=1, status="timed_out", reason="after 60 s")]
    row = wide(cells).iloc[0]
    assert row["test.psnr_db.mean"] == 30.0
    assert row["status"] == "test timed_out"
    assert row["reason"] == "after 60 s"


def test_infinite_values_do_not_poison_a_mean_and_are_counted() -> None:
    row = wide([result(psnr=(30.0, math.inf, 32.0))]).iloc[0]
    assert row["test.psnr_db.mean"] == 31.0
    assert row["test.psnr_db.infinite"] == 1
    lossless = wide([result(psnr=(math.inf, math.inf))]).iloc[0]
    assert lossless["test.psnr_db.mean"] == math.inf
    assert lossless["test.psnr_db.median"] == math.inf


@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("mean", np.mean),
        ("std", lambda x: np.std(x, ddof=1)),
        ("median", np.median),
        ("p95", lambda x: np.percentile(x, 95)),
        ("iqr", lambda x: np.subtract(*np.percentile(x, [75, 25]))),
        ("min", np.min),
        ("max", np.max),
        ("sum", np.sum),
    ],
)
def test_aggregates_agree_with_numpy(name: str, reference, rng: np.random.Generator) -> None:  # type: ignore[no-untyped-def]
    values = rng.normal(10, 3, 37)
    assert aggregate(name, values) == pytest.approx(reference(values))
    assert aggregate(name, np.append(values, np.nan)) == pytest.approx(reference(values))


def test_aggregates_of_nothing_are_missing() -> None:
    for name in AGGREGATES:
        assert math.isnan(aggregate(name, np.array([])))
        assert math.isnan(aggregate(name, np.array([np.nan])))


def test_the_bootstrap_interval_covers_the_median_as_often_as_it_says(rng: np.random.Generator) -> None:
    covered = 0
    for _ in range(200):
        low, high = median_interval(rng.normal(0, 1, 25))
        covered += low <= 0 <= high
    assert 0.88 <= covered / 200 <= 0.995
    assert all(math.isnan(end) for end in median_interval(np.array([1.0, 2.0])))
