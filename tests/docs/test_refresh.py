"""Results in README.md and docs/ are of today's plugins, and docs/refresh makes them from runs and scripts."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from project import DOCS, ROOT

import codecbench

sys.path.insert(0, str(DOCS))
sys.path.insert(0, str(DOCS / "refresh"))
import blocks
import jobs
import newcomer
import tables

SMALL = """
version: 1
name: small
sequences: [{use: synthetic, params: {stop: 2, width: 96, height: 72}}]
codecs: [raw, {use: jpeg, params: {quality: {grid: [5, 40, 95]}}}]
evaluators: [quality, features]
run: {workers: 1}
"""


def command(*words: str | Path, status: int = 0) -> str:
    """What a program of this Python prints, after checking its exit status."""
    done = subprocess.run([sys.executable, *map(str, words)], capture_output=True, text=True, timeout=300)
    assert done.returncode == status, done.stdout + done.stderr
    return done.stdout


LOCATED = """
version: 1
name: located
sequences: [{use: synthetic, params: {world: room, frames: 60, width: 320, height: 240, color: gray}}]
codecs:
  - raw
  - {use: jpeg, params: {quality: {grid: [2, 20, 50, 90]}}}
  - {use: orb_features, params: {mode: inter}}
evaluators:
  - quality
  - localization
  - {use: trajectory, params: {start_offsets: [0, 1, 2, 3]}}
  - {use: timing, params: {frames: 3, repeats: 1}}
run: {workers: 1}
"""


def table_rows(text: str) -> list[list[str]]:
    """Cells of the rows of a Markdown table, heads first."""
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A copy of the pages, which a test may rewrite."""
    shutil.copytree(DOCS, tmp_path / "docs", ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    shutil.copy(ROOT / "README.md", tmp_path)
    return tmp_path


def test_every_block_is_of_todays_plugins() -> None:
    assert command(DOCS / "refresh", "--check").startswith(f"all {len(jobs.BLOCKS)} blocks are ")


def test_a_block_lags_when_a_plugin_has_another_version(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    today = blocks.version_today
    monkeypatch.setattr(blocks, "version_today", lambda kind, name: "99" if name == "png" else today(kind, name))
    page = root / "docs" / "performance.md"
    version = today("codec", "png")
    assert f"png@{version}" in page.read_text()
    (line,) = (line for line in jobs.check(root) if line.startswith("docs/performance.md: codecs: "))
    for fact in (f" png {version}, ", " 99 today", ": python docs/refresh benchmarks"):
        assert fact in line


def test_a_new_release_of_a_library_makes_no_block_lag(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    today = blocks.version_today

    def later(kind: str, name: str) -> str:
        version = today(kind, name)  # empty if what the plugin needs is not installed
        return version and f"{version}+libnew 9.1"

    monkeypatch.setattr(blocks, "version_today", later)
    assert not any("which is" in line for line in jobs.check(root))


def test_a_block_that_was_edited_or_whose_figure_was_is_named(root: Path) -> None:
    page = root / "docs" / "first-run.md"
    page.write_text(page.read_text().replace("| raw |", "| row |"))
    (root / "docs" / "images" / "localization.svg").write_text("<svg/>")
    found = [line.split(": ", 2) for line in jobs.check(root)]
    blocks_found = {name: root / page for page, name, fault in found if fault.startswith("edited")}
    assert len(blocks_found) == len(found)
    assert blocks_found == {
        "answer": root / "README.md", "first": page, "reference": root / "docs" / "reference-table.md"
    }  # fmt: skip


def test_a_block_that_nothing_makes_or_no_run_made_or_no_page_has_is_named(root: Path) -> None:
    page = root / "docs" / "worlds.md"
    text = page.read_text().replace("worlds: begin", "others: begin").replace("worlds: end", "others: end")
    page.write_text(text.replace("<sub>", "<b>").replace("`room` | a furnished room", "`room` | a house"))
    found = {}
    for line in jobs.check(root):
        place, name, found[name] = line.split(": ", 2)
        assert place == "docs/worlds.md"
    assert found["others"].startswith("nothing makes")
    assert found["worlds"].endswith("no such block")
    assert found["sheet"].startswith("no stamp")
    assert found["conditions"].startswith("differs")


def test_a_script_runs_again_when_a_plugin_has_another_version(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    count = "import pathlib as p; f = p.Path(r'%s'); f.write_text(f.read_text() + 'x' if f.exists() else 'x')"
    script = jobs.Script(("-c", f"{count % (tmp_path / 'count')}; print('rows')"), (("codec", "jpeg"),))
    monkeypatch.setitem(jobs.SCRIPTS, "processes", script)
    for expected in ("x", "x"):
        jobs.run("processes", tmp_path)
        assert (tmp_path / "count").read_text() == expected
    monkeypatch.setattr(blocks, "version_today", lambda kind, name: "99")
    jobs.run("processes", tmp_path)
    assert (tmp_path / "count").read_text() == "xx"
    text, stamp = jobs.made("processes", tmp_path)
    assert text == "rows\n"
    assert stamp.plugins == {("codec", "jpeg", "99")}


@pytest.mark.thorough
def test_a_run_becomes_a_block_with_the_stamp_of_its_plugins(root: Path, tmp_path: Path) -> None:
    (tmp_path / "matrix.yaml").write_text(SMALL)
    command("-m", "codecbench", "run", tmp_path / "matrix.yaml", "--out", tmp_path / "first", "--quiet")
    declared = [name for name, block in jobs.BLOCKS.items() if not block.jobs]
    assert jobs.writable("first", tmp_path, ()) == ["first", *declared]
    assert jobs.write("first", tmp_path, root)
    assert not jobs.write("first", tmp_path, root)
    block = blocks.blocks_of(root / "docs" / "first-run.md")["first"]
    heads, *rows = table_rows(block)
    wide = codecbench.open_run(tmp_path / "first").wide.reset_index()
    assert [row[:2] for row in rows] == wide[["codec", "setting"]].to_numpy().tolist()
    columns = {
        "bit/px": wide["quality.rate_bpp.mean"],
        "PSNR dB": wide["quality.psnr_gray_db.mean"],
        "keypoint repeatability": wide["features.keypoint_repeatability.mean"],
    }
    for head, expected in columns.items():
        shown = pd.Series([float(row[heads.index(head)].replace("∞", "inf")) for row in rows])
        pd.testing.assert_series_equal(shown, expected, rtol=5e-4, atol=5e-4, check_names=False)
    assert {row[heads.index("encode ms")] for row in rows} == {"–"}, "what was not measured is a dash"
    (stamp,) = re.findall(r"<sub>.*</sub>", block)
    assert f"codec jpeg@{blocks.version_today('codec', 'jpeg')}, raw" in stamp
    assert f"evaluator features@{blocks.version_today('evaluator', 'features')}, quality" in stamp
    assert "first-run" not in "\n".join(jobs.check(root))


@pytest.mark.thorough
def test_picks_and_verdicts_are_those_that_codecbench_rank_prints(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "matrix.yaml").write_text(LOCATED)
    folder = tmp_path / "located"
    command("-m", "codecbench", "run", tmp_path / "matrix.yaml", "--out", folder, "--quiet")
    monkeypatch.setenv("COLUMNS", "200")
    printed = command("-m", "codecbench", "rank", folder)
    run = codecbench.open_run(folder)

    heads, *picks = table_rows("\n".join(tables.picked()(run)))
    assert heads[:5] == ["codec", "setting", "Mbit/s", "localization AUC", "tracked"]
    expected = [re.split(r"  +", line.strip()) for line in printed.splitlines() if re.match(r"(jpeg|orb)\S* ", line)]
    assert [[row[0], row[1], row[2], row[3]] for row in picks] == [
        [f"`{codec}`", f"`{setting}`", rate, auc] for codec, setting, rate, _, auc, _ in expected
    ]
    assert {row[4] for row in picks} == {"4/4"}
    assert "runs 4/4." in printed
    times = run.wide.set_index("setting")["timing.encode_wall_ms.median"]
    assert [float(row[5]) for row in picks] == pytest.approx([times[row[1].strip("`")] for row in picks], rel=0.06)
    assert table_rows("\n".join(tables.picked("orb_features")(run)))[1:] == picks[1:]

    settings = table_rows("\n".join(tables.judged("jpeg")(run)))[1:]
    assert [row[0] for row in settings] == [f"`quality={quality}`" for quality in (90, 50, 20, 2)]
    assert picks[0][1] == [row[0] for row in settings if row[-1] == "passes"][-1]
    assert f"next coarser {settings[-1][0].strip('`')} fails".split()[-2:] == expected[0][-1].split()


def test_rows_that_a_script_printed_become_a_table() -> None:
    printed = "begun\n| what | measured |\n|---|---:|\nINFO | `python -c pass` | 11 ms |\nended\n"
    (content,) = tables.printed("what", "measured")(printed)
    assert table_rows(content) == [["what", "measured"], ["`python -c pass`", "11 ms"]]


def test_what_a_newcomer_sees_is_the_end_of_what_commands_printed() -> None:
    """The README's own commands, in order, with outputs as they are, cut down."""
    outputs = [
        "cells: 89 ok\nThe pick of each codec, room\nrows\n",
        "page\n",
        "..\n7 passed, 1 skipped in 9.00s\n",
        "",
        "found\nThe pick of each codec, mine\nrows\n\nUse jpeg.\n",
    ]
    said = newcomer.commands((ROOT / "README.md").read_text(), Path("/recordings/mine"))
    assert said[-1].endswith("bin/codecbench try mine")
    assert said[:3] == newcomer.commands((ROOT / "README.md").read_text(), None)
    entries = [
        {"command": command, "seconds": 62.4, "output": output} for command, output in zip(said, outputs, strict=True)
    ]
    shown = {name: "\n".join(jobs.BLOCKS[f"newcomer-{name}"].content(json.dumps(entries))) for name in ("run", "try")}
    took, printed = re.fullmatch(r"(.*)\n\n```text\n(.*)\n```", shown["run"], re.DOTALL).groups()  # type: ignore[union-attr]
    assert "1 min 2 s" in took
    assert printed.splitlines() == outputs[0].splitlines()[1:]
    assert "```text\nUse jpeg.\n```" in shown["try"]


def test_benchmarks_become_tables() -> None:
    """From a file as pytest-benchmark writes it, cut down to what is read."""

    def entry(file: str, name: str, median_s: float, extra: dict[str, object], **params: object) -> dict[str, object]:
        part = name.partition("[")[2].rstrip("]") or None
        return {
            "name": name, "fullname": f"tests/benchmarks/{file}.py::{name}", "param": part, "params": params or None,
            "stats": {"median": median_s}, "extra_info": extra,
        }  # fmt: skip

    found = [
        entry("test_evaluators", "test_ms_ssim", 0.002, {}),
        entry("test_evaluators", "test_one_frame_or_pair[localization]", 0.36, {"units": 40}),
    ]
    for number, (way, picture) in enumerate([(w, p) for w in ("encode", "decode") for p in ("gray", "rgb")]):
        extra: dict[str, object] = {"setting": "q=7"} if way == "encode" else {}
        found.append(entry("test_codecs", f"test_{way}[x]", 1e-3 * (number + 1), extra, picture=picture, codec="x"))
    text = json.dumps({"benchmarks": found})
    (evaluators,), (codecs,) = tables.evaluator_times(text), tables.coding_times(text)
    assert [(row[0].split(", ")[-1], row[1]) for row in table_rows(evaluators)[1:]] == [
        ("ms ssim", "2 ms"), ("localization", "9 ms"),
    ]  # fmt: skip
    assert table_rows(codecs) == [
        ["codec", *(f"{picture} {way} ms" for picture in ("gray", "rgb", "depth") for way in ("encode", "decode"))],
        ["`x`, q=7", "1", "3", "2", "4", "–", "–"],
    ]


def test_cheaper_metrics_are_correlated_with_tasks_over_lossy_settings() -> None:
    """Two metrics in the order of the settings, and one against it; the lossless setting takes no part."""
    rows = pd.DataFrame({"codec": ["a", "a", "b", "raw"], "quality.psnr_gray_db.mean": [30.0, 35.0, 40.0, np.inf]})
    rising, falling = [1.0, 2.0, 3.0, 0.0], [3.0, 2.0, 1.0, 0.0]
    for name in ("quality.ssim_matlab", "features.keypoint_repeatability", "features.matches_kept"):
        rows[f"{name}.mean"] = rising
    for name in ("features.opencv_keypoint_repeatability", "features.opencv_matches_kept"):
        rows[f"{name}.mean"] = falling
    for name in ("localization.located_auc", "localization.tracked_inliers"):
        rows[f"{name}.mean"] = rising
    for name in ("relative_pose.pose_auc_10deg", "relative_pose.correct_matches"):
        rows[f"{name}.mean"] = rising

    run = SimpleNamespace(wide=rows, plan=SimpleNamespace(sequences=[SimpleNamespace(frames=7)]))
    content, last = tables.followers(run)  # type: ignore[arg-type]
    assert [row[1:] for row in table_rows(content)[1:]] == [["1.000"] * 4] * 4 + [["-1.000"] * 4] * 2
    assert re.findall(r"\d+ \w+", last) == ["3 lossy", "2 codecs", "7 frames"]


def test_paths_have_a_row_a_sequence_setting_and_backend() -> None:
    values = {"tracked_fraction.median": 0.5, "ate_rmse_m.median": 0.01, "success.mean": 1.0}
    head: dict[str, object] = {"sequence": "s", "codec": "raw", "setting": ""}
    one = head | {f"trajectory.{name}": value for name, value in values.items()}
    two = head | {f"trajectory(backend={b}).{name}": k * v for k, b in enumerate("ab", 1) for name, v in values.items()}
    ours, both = (
        table_rows("\n".join(tables.paths(SimpleNamespace(wide=pd.DataFrame([row])))))  # type: ignore[arg-type]
        for row in (one, two)
    )
    assert ours == [
        ["sequence", "codec", "setting", "tracked", "ATE mm", "runs that succeed"],
        ["s", "raw", "", "0.5", "10", "1"],
    ]
    assert both == [
        ["sequence", "codec", "setting", "backend", "tracked", "ATE mm", "runs that succeed"],
        ["s", "raw", "", "a", "0.5", "10", "1"],
        ["s", "raw", "", "b", "1", "20", "2"],
    ]
