"""The packages of the guides, each installed on a path and used by the command in a process of its own."""

from __future__ import annotations

import csv
import io
import os
import re
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from distributions import THIRD_PARTY, register
from warm_command import run_warm

DOCS = THIRD_PARTY.parent.parent / "docs"
GUIDES = {
    "corners": "writing-a-feature-codec.md",
    "delta": "writing-a-stream-codec.md",
    "npy": "writing-a-dataset.md",
    "drift": "writing-a-slam-backend.md",
    "inline": "writing-an-executor.md",
    "turns": "writing-a-link.md",
    "edges": "writing-an-evaluator.md",
}
Call = Callable[..., str]


def _page(name: str) -> str:
    return (DOCS / GUIDES[name]).read_text()


def _matrix(name: str) -> str:
    (block,) = re.findall(r"```yaml\n(.*?)```", _page(name), re.DOTALL)
    return block


@pytest.fixture
def call(request: pytest.FixtureRequest, tmp_path: Path) -> Call:
    """Runs `codecbench` in `tmp_path`, where the package that the test names is installed and its matrix lies."""
    name = request.param
    package = THIRD_PARTY / name / f"codecbench_{name}"
    site = tmp_path / "site"
    shutil.copytree(package, site / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    register(site, f"codecbench-{name}", "0.1.0", package.name)
    (tmp_path / "matrix.yaml").write_text(_matrix(name))

    def codecbench(*words: str, status: int = 0) -> str:
        environment = {**os.environ, "PYTHONPATH": str(site), "COLUMNS": "200"}
        done = run_warm(words, tmp_path, environment)
        assert done.returncode == status, done.stdout + done.stderr
        return done.stdout + done.stderr if status else done.stdout

    return codecbench


def _samples(text: str, metric: str) -> list[float]:
    return [float(row["value"] or "nan") for row in csv.DictReader(io.StringIO(text)) if row["metric"] == metric]


@pytest.mark.parametrize("name", GUIDES)
def test_the_guide_shows_the_package_that_is_tested(name: str) -> None:
    for file in sorted((THIRD_PARTY / name).glob("codecbench_*/*.py")):
        assert file.read_text() in _page(name), file


@pytest.mark.parametrize("name", GUIDES)
def test_the_guide_shows_the_project_that_is_tested_or_how_it_differs_from_the_codecs(name: str) -> None:
    text = (THIRD_PARTY / name / "pyproject.toml").read_text()
    if text in _page(name):
        return
    assert re.search(rf"#the-package\), with `{name}` .* `posterize`", _page(name))
    (shown,) = re.findall(r"```toml\n(.*?)```", (DOCS / "writing-a-codec.md").read_text(), re.DOTALL)
    project, expected = tomllib.loads(text), tomllib.loads(shown.replace("posterize", name))
    further = [word for word in project["project"]["dependencies"] if word not in expected["project"]["dependencies"]]
    for word in further:
        assert f"`{word}` as a second dependency" in " ".join(_page(name).split())
    expected["project"]["dependencies"] += further
    expected["project"]["version"] = project["project"]["version"]
    assert project == expected


@pytest.mark.thorough
@pytest.mark.parametrize("call", ["npy"], indirect=True)
def test_frames_of_a_dataset_reach_the_table(call: Call, tmp_path: Path, rng: np.random.Generator) -> None:
    frames = rng.integers(0, 256, (5, 24, 32, 3), dtype=np.uint8)
    np.save(tmp_path / "frames.npy", frames)
    call("run", "matrix.yaml", "--quiet", "--out", "run")
    raw_bits = _samples(call("table", "run", "--tidy", "--format", "csv"), "size_bytes")
    assert len(raw_bits) == 5
    assert min(raw_bits) == max(raw_bits) >= 24 * 32 * 3


@pytest.mark.thorough
@pytest.mark.parametrize("call", ["npy"], indirect=True)
def test_frames_of_a_dataset_are_known_again_and_wrong_ones_refused(
    call: Call, tmp_path: Path, rng: np.random.Generator
) -> None:
    frames = rng.integers(0, 256, (5, 24, 32, 3), dtype=np.uint8)
    np.save(tmp_path / "frames.npy", frames)
    assert "  - use: npy\n" in call("init", "--from", "frames.npy", "--codec", "png", "--out", "-")
    assert "one NumPy file" in call("list", "datasets")
    call("run", "matrix.yaml", "--quiet", "--out", "run")
    assert "of them from" in call("run", "matrix.yaml", "--quiet", "--out", "run")
    np.save(tmp_path / "frames.npy", frames.astype(np.float32))
    assert "float32 (5, 24, 32, 3); allowed: uint8" in call("run", "matrix.yaml", "--out", "other", status=2)


@pytest.mark.thorough
@pytest.mark.parametrize("call", ["delta"], indirect=True)
def test_a_codec_with_memory_reaches_the_table_and_its_delay_is_noted(call: Call, tmp_path: Path) -> None:
    assert "differences between pictures" in call("list", "codecs")
    shown = call("run", "matrix.yaml", "--out", "run")
    assert re.search(r"^delta, hold=3: .* 3 .*\(100 ms\)", shown, re.MULTILINE)
    table = call("table", "run", "--tidy", "--format", "csv")
    assert _samples(table, "delay_frames") == [0.0, 0.0, 3.0]
    assert set(_samples(table, "psnr_gray_db")) == {float("inf")}
    sizes = _samples(table, "mean_frame_bytes")
    assert sizes[1] == sizes[2] < sizes[0]
    for path in sorted((tmp_path / "run" / "coded").glob("*.bits")):
        content = bytearray(path.read_bytes())
        content[60] ^= 1
        path.write_bytes(content)
    again = call("run", "matrix.yaml", "--out", "run", "--recompute", "quality")
    assert "6 ok" in again
    assert call("table", "run", "--tidy", "--format", "csv") == table


@pytest.mark.thorough
@pytest.mark.parametrize("call", ["corners"], indirect=True)
def test_a_codec_of_features_stands_beside_codecs_of_pictures(call: Call) -> None:
    assert "ORB features, deflated" in call("list", "codecs")
    assert "skip  threads" in call("verify", "corners", "--only", "loss", "--only", "threads")
    call("run", "matrix.yaml", "--quiet", "--out", "run")
    table = call("table", "run", "--tidy", "--format", "csv")
    rates = [np.mean(part) for part in np.split(np.array(_samples(table, "rate_bpp")), 4)]
    assert rates[0] == pytest.approx(24.0, rel=0.01)
    assert rates[3] < rates[2] < rates[0]
    tracked = _samples(table, "tracked_fraction")
    assert len(tracked) == 4
    assert min(tracked) > 0.5
    assert tracked[2] == tracked[3]


@pytest.mark.thorough
@pytest.mark.parametrize("call", ["drift"], indirect=True)
def test_a_backend_is_run_by_the_trajectory_evaluator(call: Call) -> None:
    assert "shifts between frames" in call("list", "slam_backends")
    call("run", "matrix.yaml", "--quiet", "--out", "run")
    table = call("table", "run", "--tidy", "--format", "csv")
    assert _samples(table, "tracked_fraction") == [1.0]
    assert 0.0 < _samples(table, "ate_rmse_m")[0] < 0.2


@pytest.mark.thorough
@pytest.mark.parametrize("call", ["inline"], indirect=True)
def test_an_executor_runs_every_cell_where_it_says(call: Call, tmp_path: Path) -> None:
    call("run", "matrix.yaml", "--quiet", "--out", "run")
    assert len(_samples(call("table", "run", "--tidy", "--format", "csv"), "psnr_gray_db")) == 6
    local = re.sub(r"executor: \w+", "executor: local", (tmp_path / "matrix.yaml").read_text())
    (tmp_path / "matrix.yaml").write_text(local)
    call("run", "matrix.yaml", "--quiet", "--out", "beside")
    tables = [call("table", folder, "--tidy", "--format", "csv") for folder in ("run", "beside")]
    assert tables[0] == tables[1]


@pytest.mark.thorough
@pytest.mark.parametrize("call", ["turns"], indirect=True)
def test_a_link_carries_what_is_delivered(call: Call) -> None:
    assert "takes turns with" in call("list", "links")
    call("run", "matrix.yaml", "--quiet", "--out", "run")
    table = call("table", "run", "--tidy", "--format", "csv")
    on_time = _samples(table, "on_time")
    assert len(on_time) == 2 * 5 * 6
    assert 0.0 < np.mean(on_time) < 1.0
    assert np.nanmin(_samples(table, "delay_ms")) >= 1.0
