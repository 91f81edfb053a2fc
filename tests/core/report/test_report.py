"""The report, the figures and the page beside the paper, made from a real run of the embedded sequence."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from chromium import CHROMIUM, browser
from told import numbers

import codecbench
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.contracts.errors import ParamsError
from codecbench.core.report.figures import draw_all
from codecbench.core.report.page import SIZE_LIMIT_BYTES, write_report
from codecbench.paper.page import write_page

pytestmark = pytest.mark.thorough

MATRIX = """
version: 1
name: small
sequences: [{use: synthetic, params: {stop: 24}}]
codecs:
  - raw
  - {use: jpeg, params: {quality: {grid: [10, 30, 60]}}}
  - {use: jpeg_qf, params: {qf: {grid: [5, 20]}}}
  - {use: multilevel, params: {qf: {grid: [5, 20, 100]}}}
evaluators:
  - quality
  - features
  - operations
  - {use: timing, params: {frames: 1, repeats: 1, warmup: 1}}
  - {use: trajectory, params: {start_offsets: [0]}}
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    folder = tmp_path_factory.mktemp("report")
    (folder / "small.yaml").write_text(MATRIX)
    return codecbench.run(folder / "small.yaml", out=folder / "run")


@pytest.fixture(scope="module")
def page(run: RunResult) -> Path:
    path = run.folder / "report" / "report.html"
    write_report(run, path)
    return path


def test_the_run_is_whole(run: RunResult) -> None:
    assert run.failed == []
    assert run.missing == 0


def test_the_page_loads_nothing_and_is_small(page: Path) -> None:
    html = page.read_text()
    assert len(html.encode()) < SIZE_LIMIT_BYTES
    own = html.split("<script>")[0]
    assert not re.search(r"""(src|href)=["']?(https?:)?//""", own)
    assert "@import" not in own


def test_every_number_of_the_page_is_in_the_tables(page: Path, run: RunResult) -> None:
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page.read_text(), re.DOTALL)
    data = json.loads(text)
    wide = run.wide
    assert data["table"]["setting"] == wide["setting"].tolist()
    assert set(data["table"]) == {*wide.columns, "curve", "place"}
    for preset in data["presets"]:
        assert preset["x"] in wide.columns
        assert preset["y"] in wide.columns
    titles = [preset["title"] for preset in data["presets"]]
    assert titles[:2] == ["Rate and PSNR", "Rate and SSIM"]
    assert titles[data["first"]].endswith("with positions held")
    beside_rate = {title.removeprefix("Rate and ") for title in titles}
    assert {"trajectory error", "tracked share"} <= beside_rate
    assert any(title.endswith("processor time and PSNR") for title in titles)
    assert [view["title"] for view in data["map_views"]] == ["Trajectories"]
    assert len(data["map_views"][0]["drawings"]) == 9
    assert {part["choice"] for part in data["bars_views"][0]["parts"]} == {"operations, source", "operations, model"}
    assert len({(found["codec"], found["setting"]) for found in data["frames"]}) == 8
    assert len(data["frames"]) == 8 * 5
    psnr = "quality.psnr_gray_db.mean"
    shown = data["table"][psnr]
    assert shown[wide["setting"].tolist().index("")] == "inf"
    where = wide["setting"].tolist().index("quality=30")
    assert shown[where] == wide[psnr].iloc[where]


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: no browser to open the page in")
def test_the_page_opens_without_a_complaint_and_every_plot_is_drawn(page: Path, tmp_path: Path) -> None:
    with browser(tmp_path) as chromium:
        opened = chromium.page()
        opened.open(page.as_uri())
        assert opened.complaints == []
        assert opened.requests == [page.as_uri()] or all(found.startswith("data:") for found in opened.requests[1:])
        charts, cells = (f"document.querySelectorAll('{part}').length" for part in ("svg.chart", "td"))
        assert opened.evaluate(charts) >= 10
        assert opened.evaluate(cells) > 50
        assert "ATE" in opened.evaluate("$('path-caption').textContent")


def test_the_frames_that_are_asked_for_are_shown(run: RunResult, tmp_path: Path) -> None:
    last = run.plan.sequences[0].frames - 1
    html = run.report(tmp_path / "page.html", frames=[last, 0]).read_text()
    assert {int(number) for number in re.findall(r'"frame":(\d+)', html)} == {0, last}
    with pytest.raises(ParamsError, match=f"frame {last + 1}; .* 0 to {last}$"):
        run.report(tmp_path / "page.html", frames=[last + 1])


def test_what_is_marked_on_a_frame_is_what_the_table_says_is_kept(run: RunResult, page: Path) -> None:
    """The mean over frames is over all of them; the page shows some, each of which is a row of the samples."""
    (text,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', page.read_text(), re.DOTALL)
    for shown in json.loads(text)["frames"]:
        (result,) = [
            found for found in run.of("features")
            if (found.cell.codec.name, found.cell.codec.label) == (shown["codec"], shown["setting"])
        ]  # fmt: skip
        frames = result.frames()
        (share,) = frames.loc[
            (frames["metric"] == "keypoint_repeatability") & (frames["frame"] == shown["frame"]), "value"
        ]
        kept, every = map(int, re.match(r"(\d+) of (\d+) keypoints repeated", shown["note"]).groups())  # type: ignore[union-attr]
        assert kept / every == pytest.approx(share, abs=1e-12)


def test_figures_are_drawn_and_repeat_exactly(run: RunResult, tmp_path: Path) -> None:
    first = {path.name: path.read_bytes() for path in draw_all(run, tmp_path / "a")}
    again = {path.name: path.read_bytes() for path in draw_all(run, tmp_path / "b")}
    assert {"synthetic-rate-psnr_gray_db.svg", "synthetic-trajectory-jpeg.svg", "operations.svg"} <= set(first)
    assert first == again


def test_the_page_beside_the_paper_has_every_table_and_contradiction(run: RunResult, tmp_path: Path) -> None:
    written = write_page([run], tmp_path / "reproduction.md")
    text = written[0].read_text()
    for number in range(1, 7):
        assert f"## Table {number}" in text
    assert "| 5 | ours, synthetic |" in text
    assert len(re.findall(r"^\d+\. \*\*", text, re.MULTILINE)) == 9
    assert text.count("### small, trajectory\n") == 1  # though two of its metrics say whether a run succeeds
    for image in re.findall(r"\]\((.*?\.svg)\)", text):
        assert (tmp_path / image).exists()
    # The formulas with the paper's conventions give the paper's totals on a frame of the paper's size.
    rows = re.findall(r"^\| ours, model, encode, synthetic \|(.*)\|$", text, re.MULTILINE)
    totals = [614_400, 844_800, 706_560, 337_920, 368_640, 1_228_800, 983_040]
    assert totals in [numbers(row)[: len(totals)] for row in rows]
