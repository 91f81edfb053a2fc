"""Tables of README.md and docs/ are made by docs/tables.py, from a run."""

from __future__ import annotations

import io
import json
import re
import runpy
import shutil
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from project import DOCS, ROOT
from scipy.stats import spearmanr

import codecbench
from codecbench.plugins.codecs.multilevel import Multilevel

sys.path.insert(0, str(DOCS))
import newcomer

PAGES = [ROOT / "README.md", *sorted(DOCS.glob("**/*.md"))]
SMALL = "{use: synthetic, name: %s, params: {stop: 2, width: 96, height: 72, seed: %d}}"
MATRIX = f"""
version: 1
name: real
sequences: [{SMALL % ("kodak", 1)}, {SMALL % ("fr3_office_100", 2)}]
codecs: [raw, {{use: jpeg, params: {{quality: {{grid: [5, 40, 95]}}}}}}]
evaluators: [quality, features]
run: {{workers: 1}}
"""


def command(*words: str | Path, status: int = 0) -> str:
    """Standard output of a program of this Python, after checking its exit status."""
    found = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, timeout=300)
    assert found.returncode == status, found.stdout + found.stderr
    return found.stdout


def tables(*words: str | Path, status: int = 0) -> str:
    """Standard output of docs/tables.py, run in this process, after checking its exit status."""
    out, ended = io.StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out):
        patch.setattr(sys, "argv", ["tables.py", *map(str, words)])
        try:
            runpy.run_path(str(DOCS / "tables.py"), run_name="__main__")
        except SystemExit as error:
            ended = int(error.code or 0)
    assert ended == status, out.getvalue()
    return out.getvalue()


def table_rows(text: str) -> list[list[str]]:
    """Cells of the rows of a Markdown table, heads first."""
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def block(page: Path, name: str) -> str:
    (content,) = re.findall(f"<!-- {name}: begin -->(.*?)<!-- {name}: end -->", page.read_text(), re.DOTALL)
    return str(content)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a few small frames, named as the sequences that the page shows."""
    folder = tmp_path_factory.mktemp("tables")
    (folder / "matrix.yaml").write_text(MATRIX)
    command("-m", "codecbench", "run", folder / "matrix.yaml", "--out", folder / "run", "--quiet")
    return folder / "run"


def copied_pages(folder: Path) -> Path:
    """A copy of the pages that a test may rewrite."""
    (folder / "docs").mkdir()
    for page in PAGES:
        if page.parent in (ROOT, DOCS):
            shutil.copy(page, folder / page.relative_to(ROOT))
    return folder


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return copied_pages(tmp_path)


@pytest.fixture(scope="module")
def written(run: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """The first block of docs/real.md as made from the run."""
    root = copied_pages(tmp_path_factory.mktemp("written"))
    out = tables("--root", root, "--run", f"real={run}")
    assert "docs/real.md: real: written" in out
    assert "docs/real.md: sequences: written" in out
    assert "differs" not in tables("--check", "--root", root, "--run", f"real={run}")
    return block(root / "docs" / "real.md", "real")


@pytest.mark.thorough
def test_a_block_that_differs_is_named(run: Path) -> None:
    out = tables("--check", "--run", f"real={run}", status=1)
    assert "docs/real.md: real: differs" in out


@pytest.mark.thorough
def test_the_page_s_table_is_made_from_a_run(run: Path, written: str) -> None:
    heads, *rows = table_rows(written)
    wide = codecbench.open_run(run).wide
    office, stills = (wide[wide["sequence"] == name].reset_index() for name in ("fr3_office_100", "kodak"))
    assert [row[:2] for row in rows] == office[["codec", "setting"]].to_numpy().tolist()
    assert len(rows) == 4
    columns = {
        "bit/px": office["quality.rate_bpp.mean"],
        "PSNR dB": office["quality.psnr_gray_db.mean"],
        "SSIM": office["quality.ssim_matlab.mean"],
        "features kept": office["features.keypoint_repeatability.mean"],
        "Kodak: bit/px": stills["quality.rate_bpp.mean"],
        "Kodak: features kept": stills["features.keypoint_repeatability.mean"],
    }
    for head, expected in columns.items():
        shown = pd.Series([float(row[heads.index(head)].replace("∞", "inf")) for row in rows])
        pd.testing.assert_series_equal(shown, expected, rtol=5e-4, atol=5e-4, check_names=False)
    assert {row[heads.index("encode ms")] for row in rows} == {"–"}, "what was not measured is a dash"


@pytest.mark.thorough
def test_the_claim_beside_the_table_is_computed_from_it(run: Path, written: str) -> None:
    wide = codecbench.open_run(run).wide
    lossy = wide[(wide["sequence"] == "fr3_office_100") & (wide["codec"] != "raw")]
    rho = spearmanr(lossy["quality.psnr_gray_db.mean"], lossy["features.keypoint_repeatability.mean"]).statistic
    assert f"Spearman's ρ {rho:.3f}" in written
    assert "here 2 frames" in written
    assert "2 photographs" in written


def test_the_claim_on_the_page_follows_from_its_table() -> None:
    text = block(DOCS / "real.md", "real")
    heads, *rows = table_rows(text)
    psnr, kept = (
        [float(row[heads.index(head)]) for row in rows if row[heads.index("PSNR dB")] != "∞"]
        for head in ("PSNR dB", "features kept")
    )
    (stated,) = re.findall(r"Spearman's ρ (\d\.\d+)", text)
    assert float(stated) == pytest.approx(spearmanr(psnr, kept).statistic, abs=2e-3)


def test_every_marked_block_has_a_generator_with_its_columns() -> None:
    known = json.loads(tables("--list"))
    marked = {name: page for page in PAGES for name in re.findall(r"<!-- ([\w-]+): begin -->", page.read_text())}
    assert {name: str(page.relative_to(ROOT)) for name, page in marked.items()} == {
        name: entry["page"] for name, entry in known.items()
    }
    for name, page in marked.items():
        heads = [line for line in block(page, name).splitlines() if line.startswith("| ")]
        rules = block(page, name).count("\n|---")
        assert bool(rules) == bool(known[name]["columns"]), name
        assert heads.count("| " + " | ".join(known[name]["columns"]) + " |") == rules, name


def test_rows_that_a_command_printed_become_a_table(root: Path, tmp_path: Path) -> None:
    printed = tmp_path / "processes.txt"
    printed.write_text("begun\n| what | measured |\n|---|---:|\nINFO | `python -c pass` | 11 ms |\nended\n")
    tables("--root", root, "--printed", f"processes={printed}")
    rows = table_rows(block(root / "docs" / "performance.md", "processes"))
    assert rows == [["what", "measured"], ["`python -c pass`", "11 ms"]]


def test_the_method_is_judged_at_the_paper_s_setting_and_at_its_best() -> None:
    rows = {row[1] for row in table_rows(block(DOCS / "multilevel.md", "rates-beside-jpeg"))}
    assert {"multilevel", "multilevel profile=context effort=best", "jpeg2000"} <= rows
    assert "multilevel group=4 color=ycbcr420 scan=coefficient table=flat" in rows


def test_what_a_newcomer_sees_is_the_end_of_what_commands_printed(root: Path, tmp_path: Path) -> None:
    """The README's own commands, in order, with outputs as they are, cut down."""
    outputs = [
        "cells: 89 ok\nThe pick of each codec, room\nrows\n",
        "page\n",
        "..\n7 passed, 1 skipped in 9.00s\n",
        "",
        "found\nThe pick of each codec, mine\nrows\n\nUse jpeg.\n",
    ]
    said = newcomer.commands((ROOT / "README.md").read_text(), Path("/recordings/mine"))
    assert said[-1] == ".venv/bin/codecbench try mine"
    assert said[:3] == newcomer.commands((ROOT / "README.md").read_text(), None)
    entries = [
        {"command": command, "seconds": 62.4, "output": output, "on": "2 cores"}
        for command, output in zip(said, outputs, strict=True)
    ]
    (tmp_path / "newcomer.json").write_text(json.dumps(entries))
    tables("--root", root, "--printed", f"newcomer={tmp_path / 'newcomer.json'}")
    shown = {name: block(root / "README.md", f"newcomer-{name}") for name in ("run", "tests", "try")}
    assert "It took 1 min 2 s on 2 cores" in shown["run"]
    assert "```text\nThe pick of each codec, room\nrows\n```" in shown["run"]
    assert "```text\n7 passed, 1 skipped in 9.00s\n```" in shown["tests"]
    assert "```text\nUse jpeg.\n```" in shown["try"]


@pytest.mark.thorough
def test_sizes_of_the_multilevel_codec_are_measured_on_pictures(root: Path, tmp_path: Path) -> None:
    pictures = [np.random.default_rng(seed).integers(0, 256, (40, 56, 3), np.uint8) for seed in range(2)]
    for number, picture in enumerate(pictures):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.ascontiguousarray(picture[..., ::-1]))
    tables("--root", root, "--pictures", tmp_path)
    heads, *rows = table_rows(block(root / "docs" / "multilevel.md", "sizes"))
    assert [row[0] for row in rows] == ["5", "10", "15", "20", "50", "75", "100"]
    for row in rows:
        one, two = (Multilevel.create(qf=float(row[0]), levels=levels) for levels in (1, 2))
        sizes = [sum(len(codec.encode(picture)) for picture in pictures) for codec in (one, two)]
        assert row[heads.index("KiB")] == f"{sizes[0] / 2048:.1f}"
        assert row[heads.index("two levels")] == f"{100 * (sizes[1] / sizes[0] - 1):+.1f} %"


def test_benchmarks_become_tables(root: Path, tmp_path: Path) -> None:
    """From a file as pytest-benchmark writes it, cut down to what is read."""

    def entry(file: str, name: str, median_s: float, **params: object) -> dict[str, object]:
        stage = name.partition("[")[2].rstrip("]") or None
        return {
            "name": name, "fullname": f"tests/benchmarks/{file}.py::{name}", "param": stage, "params": params or None,
            "stats": {"median": median_s}, "extra_info": extra.get(name.partition("[")[0], {}),
        }  # fmt: skip

    extra = {"test_encode": {"setting": "q=7"}, "test_one_frame_or_pair": {"units": 40}}
    coded = entry("test_contract", "test_encode[gray]", 0.1)
    coded["extra_info"] = {"bare_ms": 1.0, "engine_ms": 1.01, "overhead_percent": 1.04}

    found = [
        entry("test_slam_solvers", "test_pose_graph[150]", 0.0781),
        entry("test_evaluators", "test_ms_ssim", 0.002),
        coded,
        entry("test_evaluators", "test_one_frame_or_pair[localization]", 0.36),
    ]
    for number, (way, picture) in enumerate([(w, p) for w in ("encode", "decode") for p in ("gray", "rgb")]):
        found.append(entry("test_codecs", f"test_{way}[x]", 1e-3 * (number + 1), picture=picture, codec="x"))
    for levels in (1, 2):
        for qf in (5, 20, 100):
            name = "test_encode_and_decode[x]"
            found.append(entry("test_multilevel", name, qf * levels / 1e3, picture="gray", levels=levels, qf=qf))
    for build, stages in (("fast", (1e-3, 2e-3)), ("counting", (4e-3, 5e-3))):
        for number, seconds in enumerate(stages):
            stage = ("x/encode/dct", "x/decode/idct")[number]
            found.append(entry("test_kernels", f"test_stage[{stage}-{build}]", seconds, build=build))
    (tmp_path / "found.json").write_text(json.dumps({"benchmarks": found}))
    tables("--root", root, "--benchmarks", tmp_path / "found.json")
    page = root / "docs" / "performance.md"
    assert table_rows(block(page, "solvers"))[1:] == [["pose graph, 150", "78.1 ms"]]
    assert table_rows(block(page, "evaluators"))[1:] == [
        ["ms ssim", "2 ms"],
        ["one frame or pair, localization", "9 ms"],
    ]
    assert table_rows(block(page, "contract"))[1:] == [["encode, gray", "1.00 ms", "1.01 ms", "+1.0 %"]]
    assert table_rows(block(page, "codecs"))[1:] == [["`x`, q=7", "1 / 3", "2 / 4"]]
    assert table_rows(block(page, "multilevel"))[2] == ["gray, levels 2", "10.0 ms", "40.0 ms", "200.0 ms"]
    assert table_rows(block(page, "kernels"))[1:] == [["`x`", "3.0 ms", "9.0 ms", "3.0"]]
