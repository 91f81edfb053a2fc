"""An evaluator of a stranger's distribution shows everywhere that ours do: by what it declares and nothing else."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from distributions import install_edges, install_posterize
from warm_command import run_warm

pytestmark = pytest.mark.thorough

MATRIX = """
version: 1
name: foreign
sequences: [{use: folder, name: drawn, params: {path: pictures}}]
codecs:
  - raw
  - {use: jpeg, params: {quality: {grid: [5, 15, 40, 90]}}}
  - {use: posterize, params: {bits: {grid: [1, 2, 3, 5]}}}
evaluators: [EVALUATORS]
run: {workers: 1}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three pictures of shapes under noise, and a site with the distributions of two strangers."""
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "site").mkdir()
    install_edges(folder / "site")
    install_posterize(folder / "site")
    (folder / "pictures").mkdir()
    rng = np.random.default_rng(7)
    for index in range(3):
        picture = rng.normal(110, 6, (96, 128)).clip(0, 255).astype(np.uint8)
        for radius, level in ((40, 150), (24, 60), (9, 230)):
            cv2.circle(picture, (40 + 8 * index, 48), radius, level, -1)
        cv2.imwrite(str(folder / "pictures" / f"{index}.png"), picture)
    (folder / "both.yaml").write_text(MATRIX.replace("EVALUATORS", "quality, edges"))
    (folder / "alone.yaml").write_text(MATRIX.replace("EVALUATORS", "edges"))
    return folder


def call(place: Path, *words: str, site: bool = True) -> str:
    """What a command prints, in a process of its own, with or without the strangers' distributions."""
    environment = {**os.environ, "COLUMNS": "200"}
    if site:
        environment["PYTHONPATH"] = str(place / "site")
    done = run_warm(words, place, environment)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def page_of(place: Path, run: str) -> tuple[str, dict[str, Any]]:
    """The report as text, and what its script draws from."""
    call(place, "report", run)
    html = (place / run / "report" / "report.html").read_text()
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    return html, json.loads(data)


@pytest.fixture(scope="module")
def printed(place: Path) -> str:
    """What the run prints when it ends."""
    return call(place, "run", "both.yaml")


@pytest.fixture(scope="module")
def page(place: Path, printed: str) -> tuple[str, dict[str, Any]]:
    return page_of(place, "runs/foreign")


def test_its_headlines_stand_in_the_terminal(place: Path, printed: str) -> None:
    assert "folder: runs/foreign" in printed
    _, above, heads, *_ = call(place, "table", "runs/foreign").splitlines()
    assert above.split() == ["edges", "edges", "vs", "PSNR"]
    assert heads.split() == ["codec", "setting", "bpp", "hold", "kept", "PNG", "%", "dB", "SSIM"]


def test_it_is_a_criterion_of_the_pareto_front(page: tuple[str, dict[str, Any]]) -> None:
    (criteria,) = re.findall(r"no other beats in all of ([^.<]*)\.", page[0])
    assert criteria.split(", ") == ["rate", "PSNR", "SSIM", "edges kept"]


def _table(html: str) -> tuple[list[str], dict[str, list[str]]]:
    """The heads, and rows by their first cell."""
    rows = [re.findall(r"<td[^>]*>([^<]*)</td>", row) for row in html.split("<tr>")[1:]]
    return re.findall(r"<th [^>]*>([^<]*)</th>", html), {row[0]: row for row in rows if row}


def test_it_has_rates_and_limits(place: Path, page: tuple[str, dict[str, Any]]) -> None:
    """Of two codecs that share no quality one is better at no more rate: a bound, as `codecbench rank` prints it."""
    summary = page[0].split('<section id="summary">')[1].split("</section>")[0]
    tables = [_table(part.split("</table>")[0]) for part in summary.split("<thead>")[1:]]
    (heads, rows), (compared, beside) = tables
    assert heads[:2] == ["curve", "settings"]
    assert sorted(rows) == ["jpeg", "posterize", "raw"]
    assert compared == ["curve", "PSNR", "SSIM", "edges kept"]
    (ranking,) = json.loads(call(place, "rank", "runs/foreign", "--format", "json"))[:1]
    assert ranking["heads"][:2] == ["codec", "rate vs. jpeg"]
    assert {row[0]: row[1] for row in ranking["rows"]} == {"jpeg": "–", "posterize": beside["posterize"][-1]}
    assert beside["posterize"][-1] == "≤ -30 %"
    limit = r"quality=\d+ is inconclusive \(1/1 runs; at least 3 more would decide\)"
    assert re.search(
        f"jpeg is not known to pass at any setting: {limit}",
        page[0].split('<section id="answer">')[1].split("</section>")[0],
    )


def test_its_curves_are_offered_with_its_labels(page: tuple[str, dict[str, Any]]) -> None:
    presets = {preset["title"]: (preset["x"], preset["y"]) for preset in page[1]["presets"]}
    rate, made, kept = "quality.rate_bpp.mean", "edges.edges_made.mean", "edges.edges_kept.mean"
    by_rate, by_made = presets["Rate and edges kept"], presets["Edges made and kept"]
    assert by_rate == (rate, kept)
    assert by_made == (made, kept)
    assert page[1]["columns"][kept]["label"] == "edges kept"
    assert kept in page[1]["brief"]


def test_what_its_cells_left_is_drawn(page: tuple[str, dict[str, Any]]) -> None:
    (view,) = page[1]["map_views"]
    assert view["title"].startswith("Edges along")
    assert len(view["drawings"]) == 9
    raw = view["drawings"][0]
    assert raw["holds"] is True
    assert [line["name"] for line in raw["lines"]] == ["original", "decoded"]
    assert raw["lines"][0]["path"] == raw["lines"][1]["path"], "the same path is kept once"


def test_its_figures_are_drawn(place: Path, printed: str) -> None:
    names = {Path(line).name for line in call(place, "plot", "runs/foreign").split()}
    assert {"drawn-rate-edges_kept.svg", "drawn-edges-jpeg.svg", "drawn-edges-posterize.svg"} <= names


@pytest.mark.thorough
def test_a_run_reads_the_same_where_the_evaluator_is_not_installed(place: Path, printed: str) -> None:
    """Labels, units and roles travel with the run; only drawings and comparisons need the plugin."""
    short = [
        Path(place, call(place, "report", "runs/foreign", "--format", "md", "--out", f"{site}.md", site=site).strip())
        for site in (True, False)
    ]
    assert short[0].read_text() == short[1].read_text()
    heads = re.findall(r", drawn, 3 frames, .*\n\n(.*\n)", short[0].read_text())
    assert [head for head in heads if head.startswith("| codec | setting | Mbit/s |")]
    tables = [call(place, "table", "runs/foreign", "--format", "md", site=site) for site in (True, False)]
    assert tables[0] == tables[1]
    assert {"edges kept", "edges hold"} <= {cell.strip() for cell in tables[0].split("|")}


@pytest.mark.thorough
def test_without_a_rate_a_limit_is_refused_with_the_reason(place: Path) -> None:
    call(place, "run", "alone.yaml", "--out", "runs/alone", "--quiet")
    html, data = page_of(place, "runs/alone")
    reason = "no rate was measured; add an evaluator with a primary metric of role rate"
    assert html.count(reason) == 3, "in the sentence on each of three codecs"
    assert "rate vs." not in html.split('id="curves"')[0]
    assert data["presets"]
