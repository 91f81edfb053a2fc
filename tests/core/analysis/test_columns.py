"""What a column of the wide table is, and which are shown first."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from codecbench.core.analysis.run_result import Column, RunSchema, columns_of
from codecbench.core.analysis.table import CellResult, wide
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting, RunSettings, SequenceEntry
from codecbench.core.facade import Run
from codecbench.core.report.page import write_report
from codecbench.core.report.tables import drop_constant_columns, export_table, format_value, select_columns, short_table

SEQUENCE = SequenceEntry("room", PluginSetting("dataset", "d", "1"), "f00d", 3, 3, True, True)
WORK = Metric(
    "work", "ops", "lower", "", ("mean", "max"), role="operations", headline=True, label="work done",
    column_header="Mops", display_unit="Mops", display_factor=1e-6,
)  # fmt: skip
SIZE = Metric("size", "B", "lower", "", role="rate", headline=True)
KEPT = Metric("kept", "%", "higher", "", role="rate", headline=True)
NOTE = Metric("note", "1", "neither", "")
METRICS = {metric.name: metric for metric in (NOTE, KEPT, SIZE, WORK)}


def result(codec: str, summaries: dict[tuple[str, str, str], float], label: str = "", **own: float) -> CellResult:
    evaluator = PluginSetting("evaluator", "test", "1", {}, label)
    cell = Cell(codec, SEQUENCE, PluginSetting("codec", codec, "1"), evaluator, 0, 0, False, None)
    measurements = tuple(Measurement(name, value) for name, value in own.items())
    return CellResult(cell, "ok", "", measurements, summaries, METRICS, lambda: None, Path())


def run_of(*results: CellResult) -> Run:
    plan = Plan("p", "", RunSettings(1, 1.0, 1, 0, PluginSetting("executor", "e", "1")), (SEQUENCE,), (), ())
    return Run(Path(), plan, results, {}, RunSchema({}, {}))


ONE = result(
    "a",
    {("work", "encode/dct", "mean"): 1e6, ("work", "encode", "mean"): 3e6, ("work", "encode", "max"): 4e6},
    label="n=2", size=100.0, note=1.0, kept=7.0,
)  # fmt: skip


def test_columns_are_those_of_the_wide_table_in_the_order_of_declaration() -> None:
    columns = columns_of([ONE])
    assert set(columns) == set(wide([ONE]).columns) - {"sequence", "codec", "setting", "status", "reason"}
    assert list(columns) == [
        "test(n=2).note.mean",
        "test(n=2).kept.mean",
        "test(n=2).size.mean",
        "test(n=2).work.encode/dct.mean",
        "test(n=2).work.encode.mean",
        "test(n=2).work.encode.max",
    ]
    assert all(name == column.name for name, column in columns.items())


def test_a_column_says_what_it_is() -> None:
    column = columns_of([ONE])["test(n=2).work.encode.mean"]
    assert column.label == "encode work done (n=2)"
    assert column.heading == f"{column.label} [Mops]"
    assert column.short_heading == "encode\nMops\nn=2"
    assert column.factor == 1e-6
    assert columns_of([ONE])["test(n=2).work.encode.max"].label.endswith("(n=2), max")
    infinite = Column(ONE.cell.evaluator, WORK, "", "infinite")
    assert (infinite.heading, infinite.factor) == ("work done (n=2), infinite", 1.0)


def test_a_metric_that_was_not_declared_stands_last_and_means_nothing() -> None:
    undeclared = replace(
        ONE, metrics={"work": WORK}, measurements=(Measurement("odd", 1.0), Measurement("odd", 2.0, stage="x"))
    )
    other = result("b", {}, note=1.0)
    columns = columns_of([replace(undeclared, summaries={("late", "", "max"): 1.0, ("work", "", "mean"): 2.0}), other])
    assert list(columns) == [
        "test(n=2).work.mean", "test(n=2).late.max", "test(n=2).odd.mean", "test(n=2).odd.x.mean", "test.note.mean",
    ]  # fmt: skip
    odd = columns["test(n=2).odd.mean"]
    assert (odd.metric, odd.heading, odd.short_heading) == (Metric("odd", "", "neither", ""), "odd (n=2)", "odd\nn=2")


def test_heads_say_no_more_than_there_is() -> None:
    note = columns_of([result("b", {}, note=1.0)])["test.note.mean"]
    assert (note.label, note.heading, note.short_heading, note.unit, note.factor) == ("note", "note", "note", "1", 1.0)
    assert columns_of([ONE])["test(n=2).size.mean"].heading == "size (n=2) [B]"
    assert Column(ONE.cell.evaluator, WORK, "", "infinite").unit == ""


def test_headlines_are_usual_summaries_in_total_that_have_a_value() -> None:
    run = run_of(ONE, result("b", {}, size=float("nan")))
    assert [column.measure for column in run.headlines()] == ["kept", "size", "work.encode"]
    assert [column.measure for column in run.headlines("operations")] == ["work.encode"]


def test_the_rate_is_the_first_that_is_better_when_lower() -> None:
    run = run_of(ONE)
    assert run.rate is not None
    assert run.rate.metric is SIZE
    assert run.rates == {("room", "a", ""): 100.0}
    assert run_of(result("a", {}, kept=3.0)).rate is None


def test_the_short_table_is_in_units_and_words_for_people() -> None:
    run = run_of(ONE)
    table = short_table(run)
    heads = [column.heading for column in run.headlines()]
    assert list(table.columns) == ["sequence", "codec", "setting", *heads, "status"]
    assert table.iloc[0].tolist() == ["room", "a", "", 7.0, 100.0, 3.0, "ok"]


def test_every_table_in_a_file_says_what_is_noted_of_a_setting(tmp_path: Path) -> None:
    """In the terminal and on pages it stands below; a file is read without what stood around it."""
    run = run_of(replace(ONE, notes=("half the color",)), result("b", {}, size=3.0))
    assert list(select_columns(run.wide, "*size*").columns)[3:] == ["test(n=2).size.mean", "test.size.mean", "notes"]
    tables = [replace(run, results=run.results[1:]).wide, run.wide]
    for form in ("csv", "json", "markdown", "latex"):
        assert [export_table(table, form).count(b"half the color") for table in tables] == [0, 1]
    for form in ("markdown", "latex"):
        write_report(run, tmp_path / form, form)
        assert (tmp_path / form).read_text().count("half the color") == 1
    assert run._repr_html_().count("half the color") == 1


def test_two_columns_under_one_head_are_both_shown() -> None:
    table = short_table(run_of(ONE))
    table.columns = pd.Index([*table.columns[:3], "same", "same", "same", "status"])
    assert export_table(table, "markdown").decode().count("same") == 3
    assert export_table(table, "latex").decode().count("same") == 3


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.6008, "0.601"), (0.9, "0.900"), (24.0, "24"), (24.004, "24.0"), (128.5, "128"), (-102.4, "-102"),
        (999.7, "1000"), (1234.5, "1230"), (12345.6, "12,300"), (1234567.8, "1,230,000"), (307200.0, "307,200"),
        (307200, "307,200"), (1.2345e-05, "1.23e-05"), (1e300, "1e+300"), (-0.0, "0"), (math.inf, "∞"),
        (-math.inf, "-∞"), (math.nan, "–"), (None, "–"), (pd.NA, "–"), ("0.6008", "0.6008"), (True, "True"),
    ],
)  # fmt: skip
def test_people_are_shown_three_digits_and_whole_numbers_in_full(value: object, text: str) -> None:
    assert format_value(value) == text


def test_constant_columns_are_listed_below_the_table() -> None:
    frame = pd.DataFrame({"sequence": ["s", "s"], "enc\nms": [0.9, 0.9], "setting": ["", ""], "gone": [None, None]})
    frame["size"] = [1.0, 2.0]
    told, said = drop_constant_columns(frame)
    assert list(told.columns) == ["size"]
    assert "sequence s, enc ms 0.900, gone –" in said
    assert drop_constant_columns(told)[1] == ""
    assert list(drop_constant_columns(frame[:1])[0].columns) == list(frame.columns)


def test_files_for_people_are_rounded_and_those_for_programs_are_not() -> None:
    frame = pd.DataFrame({"codec": ["a*", "b_c"], "bits [%]": [0.60083, math.inf]})
    assert export_table(frame, "markdown", "all rows: ok").decode().splitlines() == [
        "| codec | bits \\[%\\] |", "|---|---:|", "| a\\* | 0.601 |", "| b_c | ∞ |", "", "all rows: ok",
    ]  # fmt: skip
    assert export_table(frame, "latex", "all rows: ok").decode().splitlines() == [
        "\\begin{tabular}{lr}", "\\toprule", "codec & bits [\\%] \\\\", "\\midrule", "a* & 0.601 \\\\",
        "b\\_c & $\\infty$ \\\\", "\\bottomrule", "\\end{tabular}", "% all rows: ok",
    ]  # fmt: skip
    assert export_table(frame, "csv", "all rows: ok").decode().splitlines() == [
        "codec,bits [%]",
        "a*,0.60083",
        "b_c,inf",
    ]


def test_a_metric_that_is_shown_with_its_sign_turned_is_better_in_the_other_direction() -> None:
    saved = Metric("saved", "%", "higher", "", display_factor=-1.0)
    assert [Column(ONE.cell.evaluator, metric, "", "mean").better for metric in (saved, KEPT, WORK, NOTE)] == [
        "lower", "higher", "lower", "neither",
    ]  # fmt: skip
