"""RRD files, read with Rerun's own reader."""

from __future__ import annotations

import subprocess
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rerun", reason="the extra `rerun` is not installed")

from exported_run import COUNT, HEIGHT, TIMES_NS, WIDTH, export, frames
from rerun.chunk import RrdReader
from warm_command import COMMAND

from codecbench.core.contracts.errors import Unsupported

Rows = dict[str, list[tuple[int | None, dict[str, Any]]]]
"""Times in nanoseconds, None of what holds at any time, and values, by entity."""


def logged(path: Path) -> Rows:
    found: Rows = defaultdict(list)
    for chunk in RrdReader(str(path)).stream():
        batch = chunk.to_record_batch()
        times = batch["time"].cast("int64").to_pylist() if "time" in batch.schema.names else [None] * batch.num_rows
        names = [name for name in batch.schema.names if ":" in name]
        found[chunk.entity_path] += zip(times, batch.select(names).to_pylist(), strict=True)
    return {entity: sorted(rows, key=lambda row: row[0] or 0) for entity, rows in found.items()}


def pixels(row: dict[str, Any]) -> np.ndarray:
    (form,), (samples,) = row["Image:format"], row["Image:buffer"]
    assert (form["width"], form["height"]) == (WIDTH, HEIGHT)
    return np.array(samples, np.uint8).reshape(HEIGHT, WIDTH)


@pytest.fixture(scope="module")
def jpeg(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Rows:
    out = tmp_path_factory.mktemp("rrd") / "jpeg.rrd"
    done = export(run, "--codec", "jpeg", "--out", str(out))
    assert done.exit_code == 0, done.output
    assert [entry.kind for entry in RrdReader(str(out)).blueprints()] == ["blueprint"]
    return logged(out)


def test_raw_and_decoded_frames_are_there_to_the_bit_at_their_times(run: Path, tmp_path: Path, jpeg: Rows) -> None:
    assert export(run, "--codec", "jpeg", "--out", str(tmp_path / "jpeg")).exit_code == 0
    decoded = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in sorted((tmp_path / "jpeg").iterdir())]
    for entity, expected in (("/camera/raw", frames()), ("/camera/decoded", decoded)):
        assert [time for time, _ in jpeg[entity]] == TIMES_NS
        np.testing.assert_array_equal([pixels(row) for _, row in jpeg[entity]], expected)
    for entity in ("/camera/raw/keypoints", "/camera/decoded/keypoints"):
        places = np.array(jpeg[entity][0][1]["Points2D:positions"])
        assert len(places) > 0
        assert (places >= 0).all()
        assert (places < (WIDTH, HEIGHT)).all()
    sizes = [row["Scalars:scalars"] for _, row in jpeg["/values/codec/size_bytes"]]
    assert sizes == [[file.stat().st_size] for file in sorted((tmp_path / "jpeg").iterdir())]
    psnr_db = [row["Scalars:scalars"][0] for _, row in jpeg["/values/quality/psnr_gray_db"]]
    assert psnr_db == pytest.approx([cv2.PSNR(*pair) for pair in zip(frames(), decoded, strict=True)])


def test_the_path_is_a_line_and_a_point_that_moves(jpeg: Rows) -> None:
    expected = [[place, 2, 3] for place in range(1, COUNT + 1)]
    assert [row["LineStrips3D:strips"] for _, row in jpeg["/paths/truth"]] == [[expected]]
    assert [time for time, _ in jpeg["/paths/truth/camera"]] == TIMES_NS
    assert [row["Points3D:positions"] for _, row in jpeg["/paths/truth/camera"]] == [[place] for place in expected]


def test_bitstreams_are_for_mcap_files(run: Path, tmp_path: Path) -> None:
    done = export(run, "--codec", "jpeg", "--coded", "--out", str(tmp_path / "a.rrd"))
    assert isinstance(done.exception, Unsupported)
    assert "leave out --coded, or write an .mcap file" in str(done.exception)
    assert not (tmp_path / "a.rrd").exists()


@pytest.mark.parametrize("last", [False, True], ids=["frames", "footer"])
def test_a_file_that_cannot_grow_ends_the_command_and_leaves_nothing(run: Path, tmp_path: Path, last: bool) -> None:
    words = ["export", run, "--codec", "raw", "--out", tmp_path / "a.rrd"]
    assert subprocess.run([COMMAND, *words], capture_output=True, timeout=100).returncode == 0
    most_kb = (tmp_path / "a.rrd").stat().st_size // 1024 if last else 40
    (tmp_path / "a.rrd").unlink()
    limited = ["bash", "-c", f'ulimit -f {most_kb}; exec "$@"', "bash", COMMAND, *words]
    done = subprocess.run(limited, capture_output=True, text=True, timeout=100)
    assert done.returncode == 3, done.stderr
    assert str(tmp_path / "a.rrd") in done.stderr
    assert "see whether the disk is full" in done.stderr
    assert not list(tmp_path.iterdir())
