"""Tables in the terminal."""

from __future__ import annotations

import math

import pandas as pd
import pytest
from measured_runs import cell_result, run_of

from codecbench.cli.display import plain_table
from codecbench.cli.messages import say
from codecbench.cli.show import show_reasons, show_summary, show_table
from codecbench.core.report.tables import short_table


@pytest.mark.parametrize(("columns", "width"), [("60", 60), ("80", 80), ("160", 160), (None, 80)])
def test_a_table_of_many_columns_is_shown_in_parts_that_fit(
    columns: str | None, width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _on_a_screen(columns, monkeypatch)
    measures = {f"quality.metric_{number}.mean": [number + 0.5, number + 0.25] for number in range(60)}
    frame = pd.DataFrame({"sequence": ["s", "s"], "codec": ["a", "b"], "setting": ["q=1", "q=2"], **measures})
    assert show_table(frame, "wide") == []
    lines = capsys.readouterr().out.splitlines()
    assert width - 11 < max(map(len, lines)) <= width
    shown = "\n".join(f"{line} " for line in lines)
    for number in range(60):
        assert f" metric_{number} " in shown
        assert f" {number + 0.25:#.3g} " in shown
    parts = shown.count("wide")
    assert parts == {60: 20, 80: 12, 160: 5}[width]
    assert shown.count(" q=2 ") == parts  # every part says which row is which


def _on_a_screen(columns: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """The variable by which rich learns how wide a screen is, without a terminal."""
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", columns)


OWN = [
    {("bits", ""): [24.0], ("score", ""): [math.inf], ("blur", ""): [2.0], ("speed", ""): [1234.5]},
    {("bits", ""): [0.6008], ("score", ""): [30.284], ("blur", ""): [2.0], ("speed", ""): [0.9]},
]


def test_the_summary_is_one_table_of_columns_that_fit_and_names_the_others(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three digits in every row, no column that is the same in all, and which have no room."""
    run = run_of(*(cell_result("plain", q, "look", own=own) for q, own in enumerate(OWN)))
    _on_a_screen("60", monkeypatch)
    show_summary(run)
    *table, same = (line.rstrip() for line in capsys.readouterr().out.splitlines())
    assert table == [
        "p",
        "setting   bits  score  speed",
        "────────────────────────────",
        "q=0         24      ∞   1230",
        "q=1      0.601   30.3  0.900",
    ]
    assert same.split(", ")[1:] == ["codec plain", "blur 2", "status ok."]
    _on_a_screen("24", monkeypatch)
    show_summary(run)
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert lines[1:5] == [
        "setting   bits  score",
        "─────────────────────",
        "q=0         24      ∞",
        "q=1      0.601   30.3",
    ]
    assert max(map(len, lines)) <= 24
    assert ": speed; --all" in " ".join(lines)


def test_a_single_row_keeps_its_columns(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    _on_a_screen(None, monkeypatch)
    show_summary(run_of(cell_result("plain", 1, "look", own=OWN[1])))
    assert [line.rstrip() for line in capsys.readouterr().out.splitlines()] == [
        "p",
        "sequence  codec  setting   bits  score  blur  speed  status",
        "───────────────────────────────────────────────────────────",
        "s         plain  q=1      0.601   30.3     2  0.900  ok",
    ]


def test_the_widest_column_is_folded_between_words(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    heads, rows = ("codec", "setting", "next coarser"), [("multilevel profile=context", "q=5", "ratio=107 fails")]
    _on_a_screen("40", monkeypatch)
    plain_table(heads, rows)
    assert [line.rstrip() for line in capsys.readouterr().out.splitlines()] == [
        "codec            setting  next coarser",
        "multilevel       q=5      ratio=107",
        "profile=context           fails",
    ]


def test_a_sentence_is_wrapped_if_the_width_is_known(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    _on_a_screen("24", monkeypatch)
    first, path = "Use good q=1.0: 1 bpp,", "runs/a/long/path/of/a/report.html"
    say(f"{first} {path}", indent=2)
    assert capsys.readouterr().out == f"{first}\n  {path}\n"
    _on_a_screen(None, monkeypatch)
    say(f"{first} {path}", indent=2)
    assert capsys.readouterr().out == f"{first} {path}\n"


def test_each_reason_is_shown_once(capsys: pytest.CaptureFixture[str]) -> None:
    crashed = [cell_result("a", rate, "size", status="crashed", reason="signal 11") for rate in (0.5, 1.0)]
    cannot = cell_result("b", 0.5, "size", status="unsupported", reason="no color")
    show_reasons(run_of(cell_result("a", 2.0, "size", own={("bits", ""): [2.0]}), cannot, *crashed))
    assert capsys.readouterr().out.splitlines() == ["crashed (2): signal 11", "unsupported (1): no color"]


def test_on_a_screen_what_is_judged_by_comes_first_and_the_status_where_one_is_not_ok() -> None:
    own = {(name, ""): [1.0] for name in ("bits", "score", "blur", "speed", "drift", "held")}
    found = cell_result("plain", 1.0, "look", own=own)
    heads = ["sequence", "codec", "setting", "bits", "held", "drift", "score", "blur", "speed"]
    assert list(short_table(run_of(found), brief=True).columns) == [*heads, "status"]
    failed = cell_result("plain", 2.0, "look", status="failed", reason="it fails")
    assert list(short_table(run_of(found, failed), brief=True).columns) == [*heads[:3], "status", *heads[3:]]
    assert list(short_table(run_of(found, failed)).columns)[-1] == "status"
