"""A stranger's bundle, opened: its text stays text, its plugins are not needed, nothing that it names is touched."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from kept_runs import write_kept_run

from codecbench import bundle, open_bundle
from codecbench.core.analysis.collect import absent_plugins
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.storage.plan_file import PlanFile
from codecbench.core.report.page import write_report
from codecbench.core.report.tables import export_table, short_table

HARM = "<img src=x onerror=alert(1)>\x1b]0;owned\x07"


def test_there_and_back(tmp_path: Path) -> None:
    write_kept_run(tmp_path / "run")
    path = bundle(tmp_path / "run")
    assert path == tmp_path / "run.bundle.zip"
    run = open_bundle(path)
    assert run.folder == tmp_path / "run.bundle"
    row = run.wide.iloc[0]
    assert (row["judge.rate_bpp.mean"], row["judge.error.mean"]) == (1.5, 1.25)
    assert bundle(run, tmp_path / "again.zip").read_bytes() == path.read_bytes()


def test_an_opened_bundle_counts_as_made_elsewhere(tmp_path: Path) -> None:
    write_kept_run(tmp_path / "run")
    assert PlanFile(tmp_path / "run").origin_elsewhere() is None
    run = open_bundle(bundle(tmp_path / "run"))
    assert PlanFile(run.folder).origin_elsewhere() is not None


def test_plugins_that_are_not_installed_are_named_and_not_needed(tmp_path: Path) -> None:
    write_kept_run(tmp_path / "run")
    before = set(sys.modules)
    run = open_bundle(bundle(tmp_path / "run"))
    assert [tuple(line.split(" of ")) for line in absent_plugins(run.plan, installed())] == [
        ("dataset ramps", "codecbench"), ("codec shifts", "somebody 1.0"), ("evaluator judge", "somebody 1.0"),
    ]  # fmt: skip
    assert [column.metric.label for column in run.headlines()] == ["rate", "error"]
    assert not {name for name in set(sys.modules) - before if name.startswith("codecbench.plugins")}


@pytest.mark.thorough
def test_text_of_a_strangers_bundle_stays_text(tmp_path: Path) -> None:
    write_kept_run(tmp_path / "run", sequence=HARM, label=HARM, note=HARM)
    run = open_bundle(bundle(tmp_path / "run"))
    write_report(run, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "<img src=x" not in page
    assert "\x1b" not in page
    assert page.count("&lt;img src=x onerror=alert(1)&gt;") >= 3  # it is shown, as text
    data = re.search(r'id="data">(.*?)</script>', page, re.DOTALL).group(1)
    assert "<" not in data
    markdown = export_table(short_table(run), "markdown").decode()
    assert "<img" not in markdown
