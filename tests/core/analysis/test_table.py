"""Tables from cells with known values."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from codecbench.core.analysis.table import TIDY_COLUMNS, CellResult, tidy, wide
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import Cell, PluginSetting, SequenceEntry
from codecbench.core.engine.storage.aggregate import summarise
from codecbench.core.engine.storage.samples import parquet_from_samples, table_from_parquet

SEQUENCE = SequenceEntry("room", PluginSetting("dataset", "synthetic", "1"), "f00d", 3, 3, True, True)
PSNR = Metric("psnr_db", "dB", "higher", "a test", aggregates=("mean", "median"))
ATE = Metric("ate_m", "m", "lower", "a test", aggregates=("median", "iqr"))
FACTORS = (("mean", 1.0), ("sum", 10.0), ("max", 100.0))
SAMPLES = table_from_parquet(
    parquet_from_samples(
        [Measurement("psnr_db", 5.0, 0, "decode"), Measurement("psnr_db", math.nan, 1, None, "bl\x1back")]
    )
)


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


def psnr(row: pd.Series[float], how: str) -> float:
    return row[f"test.psnr_db.{how}"]


def test_what_is_noted_of_a_setting_is_the_last_column_of_both_tables() -> None:
    """Of a setting, not of a cell: an evaluator that noted nothing measured the same setting."""
    note = "half the color"
    noted = [replace(result(psnr=(30.0,)), notes=(note, "waits")), result(repeat=1, psnr=(31.0, 32.0))]
    cells = [*noted, result(codec="raw", label="", psnr=(math.inf,)), result(codec="slow", status="crashed")]
    tables = tidy(cells), wide(cells)
    assert [table.columns[-1] for table in tables] == ["notes", "notes"]
    assert tables[0]["notes"].tolist() == [f"{note}; waits"] * 3 + ["", ""]
    assert tables[1]["notes"].tolist() == [f"{note}; waits", "", ""]


def test_where_nothing_is_noted_there_is_no_column_of_notes() -> None:
    plain, noted = [result(psnr=(30.0,))], [replace(result(psnr=(30.0,)), notes=("half the color",))]
    for table in (tidy, wide):
        assert "notes" not in table(plain)
        pd.testing.assert_frame_equal(table(noted).drop(columns="notes"), table(plain))


def test_wide_aggregates_over_frames_and_then_over_repeats() -> None:
    cells = [result(repeat=0, psnr=(30.0, 32.0, 40.0)), result(repeat=1, psnr=(20.0, 21.0, 25.0))]
    row = wide(cells).iloc[0]
    assert psnr(row, "mean") == pytest.approx(np.mean([34.0, 22.0]))
    assert psnr(row, "median") == pytest.approx(np.median([32.0, 21.0]))
    assert row["status"] == "ok"


def test_wide_aggregates_single_values_over_repeats() -> None:
    cells = [result(repeat=index, own=(Measurement("ate_m", value),)) for index, value in enumerate((1.0, 2.0, 9.0))]
    row = wide(cells).iloc[0]
    assert row["test.ate_m.median"] == 2.0
    assert row["test.ate_m.iqr"] == pytest.approx(np.subtract(*np.percentile([1, 2, 9], [75, 25])))


def test_wide_says_what_failed_and_keeps_the_rest() -> None:
    cells = [result(psnr=(30.0,)), result(repeat=1, status="timed_out", reason="after 60 s")]
    row = wide(cells).iloc[0]
    assert psnr(row, "mean") == 30.0
    assert row["status"] == "test timed_out"
    assert row["reason"] == "after 60 s"


def test_infinite_values_do_not_poison_a_mean_and_are_counted() -> None:
    row = wide([result(psnr=(30.0, math.inf, 32.0))]).iloc[0]
    assert psnr(row, "mean") == 31.0
    assert psnr(row, "infinite") == 1
    lossless = wide([result(psnr=(math.inf, math.inf))]).iloc[0]
    assert psnr(lossless, "mean") == math.inf
    assert psnr(lossless, "median") == math.inf


def test_what_is_none_stays_none_beside_text_of_other_rows() -> None:
    """Own measurements and samples of frames, each with and without stage and reason, of several cells."""
    own = (
        Measurement("ate_m", 1.0, stage="encode"),
        Measurement("ate_m", 2.0, reason="guess"),
        Measurement("odd", 3.0),
    )
    cells = [
        replace(result(psnr=(30.0,), own=own), samples=lambda: SAMPLES),
        result(codec="png", label="", repeat=2, own=(Measurement("ate_m", 4.0),)),
        result(codec="png", label="", repeat=3, status="failed"),
    ]
    table = tidy(cells)
    rows = table.astype(object).where(table.notna(), None)
    assert rows[
        ["codec", "repeat", "metric", "unit", "frame", "stage", "value", "status", "reason"]
    ].values.tolist() == [
        ["jpeg", 0, "ate_m", "m", None, "encode", 1.0, "ok", None],
        ["jpeg", 0, "ate_m", "m", None, None, 2.0, "ok", "guess"],
        ["jpeg", 0, "odd", "", None, None, 3.0, "ok", None],
        ["jpeg", 0, "psnr_db", "dB", 0, "decode", 5.0, "ok", None],
        ["jpeg", 0, "psnr_db", "dB", 1, None, None, "ok", "bl\\x1back"],
        ["png", 2, "ate_m", "m", None, None, 4.0, "ok", None],
        ["png", 3, None, None, None, None, None, "failed", None],
    ]
    assert str(table["frame"].dtype) == "Int32"
    assert all(isinstance(table[name].dtype, pd.CategoricalDtype) for name in ("codec", "metric", "stage", "reason"))
    assert table["metric"].cat.categories.tolist() == ["ate_m", "odd", "psnr_db"]


def test_samples_of_a_cell_that_is_not_ok_are_not_shown() -> None:
    table = tidy([result(psnr=(30.0, 31.0), status="failed", reason="late")])
    assert table[["metric", "status", "reason"]].astype(object).fillna("").values.tolist() == [["", "failed", "late"]]


def test_repeats_are_joined_by_means_of_means_and_of_sums_and_medians_of_the_rest() -> None:
    cells = [
        replace(result(repeat=index), summaries={("psnr_db", "", how): value * factor for how, factor in FACTORS})
        for index, value in enumerate((1.0, 2.0, 9.0))
    ]
    row = wide(cells).iloc[0]
    assert [row[f"test.psnr_db.{how}"] for how, _ in FACTORS] == [4.0, 40.0, 200.0]


def test_of_a_single_value_only_the_middle_is_shown() -> None:
    own = (Measurement("ate_m", 1.5), Measurement("ate_m", 2.5, stage="late"), Measurement("odd", 3.0))
    metrics = {"ate_m": Metric("ate_m", "m", "lower", "", aggregates=("mean", "median", "iqr", "max"))}
    table = wide([replace(result(own=own), metrics=metrics)])
    assert list(table.columns) == [
        "sequence", "codec", "setting", "test.ate_m.mean", "test.ate_m.median", "test.ate_m.late.mean",
        "test.ate_m.late.median", "test.odd.mean", "status", "reason",
    ]  # fmt: skip
    assert table.iloc[0].tolist() == ["room", "jpeg", "quality=10", 1.5, 1.5, 2.5, 2.5, 3.0, "ok", ""]
    two = [
        replace(result(own=(Measurement("ate_m", value),), repeat=n), metrics=metrics) for n, value in enumerate((1, 2))
    ]
    assert wide(two).iloc[0][["test.ate_m.iqr", "test.ate_m.max"]].tolist() == [0.5, 2.0]


def test_a_row_counts_what_failed_by_evaluator_and_gives_the_first_reason() -> None:
    other = PluginSetting("evaluator", "other", "1")
    cells = [
        result(repeat=0, status="failed", reason="first"),
        result(repeat=1, status="failed", reason="second"),
        result(repeat=2, status="crashed", reason="third"),
    ]
    cells.append(replace(cells[0], cell=replace(cells[0].cell, evaluator=other), reason="last"))
    row = wide(cells).iloc[0]
    assert row["status"].split(", ") == ["test failed (2 repeats)", "test crashed", "other failed"]
    assert row["reason"] == "first"


def test_settings_and_sequences_have_rows_of_their_own() -> None:
    cells = [result(label="q=1"), result(label="q=2"), result(codec="png", label="q=1"), result(label="q=1", repeat=1)]
    moved = replace(cells[0], cell=replace(cells[0].cell, sequence=replace(SEQUENCE, name="hall")))
    table = wide([*cells, moved])
    assert table[["sequence", "codec", "setting"]].values.tolist() == [
        ["room", "jpeg", "q=1"], ["room", "jpeg", "q=2"], ["room", "png", "q=1"], ["hall", "jpeg", "q=1"],
    ]  # fmt: skip
    assert list(wide([]).columns) == ["sequence", "codec", "setting", "status", "reason"]


def test_samples_of_single_frames_are_a_table_of_their_own() -> None:
    frames = result(psnr=(30.0, 31.0)).frames()
    assert frames[["metric", "frame", "value"]].values.tolist() == [["psnr_db", 0, 30.0], ["psnr_db", 1, 31.0]]
