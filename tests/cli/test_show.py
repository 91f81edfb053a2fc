"""Tables in the terminal."""

from __future__ import annotations

from types import SimpleNamespace

import pandas as pd
import pytest
from measured_runs import cell_result, run_of

from codecbench.cli.show import show_reasons, show_table
from codecbench.core.report.tables import short_table


def test_a_table_of_many_columns_is_shown_in_parts_that_fit(capsys: pytest.CaptureFixture[str]) -> None:
    measures = {f"quality.metric_{number}.mean": [number + 0.5, number + 0.25] for number in range(60)}
    frame = pd.DataFrame({"sequence": ["s", "s"], "codec": ["a", "b"], "setting": ["q=1", "q=2"], **measures})
    show_table(frame, SimpleNamespace(plan=SimpleNamespace(name="wide")))  # type: ignore[arg-type]
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 160
    shown = "\n".join(lines)
    for number in range(60):
        assert f" metric_{number} " in shown
        assert f" {number + 0.25:.4g} " in shown
    parts = shown.count("wide")
    assert 5 < parts < 12
    assert shown.count(" q=2 ") == parts  # every part says which row is which


def test_each_reason_is_shown_once(capsys: pytest.CaptureFixture[str]) -> None:
    crashed = [cell_result("a", rate, "size", status="crashed", reason="signal 11") for rate in (0.5, 1.0)]
    cannot = cell_result("b", 0.5, "size", status="unsupported", reason="no colour")
    show_reasons(run_of(cell_result("a", 2.0, "size", own={("bits", ""): [2.0]}), cannot, *crashed))
    assert capsys.readouterr().out.splitlines() == ["crashed (2): signal 11", "unsupported (1): no colour"]


def test_on_a_screen_what_is_judged_by_comes_first_and_the_status_where_one_is_not_ok() -> None:
    own = {(name, ""): [1.0] for name in ("bits", "score", "blur", "speed", "drift", "held")}
    found = cell_result("plain", 1.0, "look", own=own)
    heads = ["sequence", "codec", "setting", "bits", "held", "drift", "score", "blur", "speed"]
    assert list(short_table(run_of(found), brief=True).columns) == [*heads, "status"]
    failed = cell_result("plain", 2.0, "look", status="failed", reason="it fails")
    assert list(short_table(run_of(found, failed), brief=True).columns) == [*heads[:3], "status", *heads[3:]]
    assert list(short_table(run_of(found, failed)).columns)[-1] == "status"
