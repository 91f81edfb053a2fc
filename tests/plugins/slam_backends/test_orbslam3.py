"""The orbslam3 backend: its child process with a stand-in for pyorbslam3, and the real one where it is installed."""

from __future__ import annotations

import importlib
import importlib.util
import re
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from codecbench.core.contracts.errors import SlamError, Unsupported
from codecbench.core.contracts.sequence import Camera, Frame
from codecbench.plugins.slam_backends.orbslam3 import OrbSlam3, OrbSlam3Params, settings_text

CAMERA = Camera(8, 6, 5.0, 5.5, 3.5, 2.5)

STAND_IN = '''
"""Behaves as pyorbslam3 does towards its caller; the gray level of the first pixel says what happens."""
import ctypes, os, signal, sys, time
import numpy as np

class Sensor:
    MONOCULAR = 1

class Result:
    def __init__(self, state, valid, pose, points):
        self.state, self.pose_valid, self.pose_wc, self.num_tracked_points = state, valid, pose, points

class Slam:
    def __init__(self, vocabulary, settings, sensor, use_viewer):
        assert open(vocabulary).readline().split()[0] == "10"
        assert "Camera1.fx: 5.0" in open(settings).read()
        assert not use_viewer
        self.stamps = []

    def track_monocular(self, gray, stamp_s):
        assert gray.dtype == np.uint8 and gray.shape == (6, 8)
        level = int(gray[0, 0])
        if level == 200:
            print("about to crash", flush=True)
            os.kill(os.getpid(), signal.SIGSEGV)
        if level == 201:
            time.sleep(60)
        if level == 202:
            ctypes.CDLL(None).puts(b"*Loop detected")
        if level == 203:
            ctypes.CDLL(None).puts(b"New Map created with 100 points")
        if level == 204:
            sys.exit(3)
        if level == 205:
            raise MemoryError("std::bad_alloc")
        if level < 3:
            return Result("TrackingState.NOT_INITIALIZED", False, None, 0)
        if level == 9:
            return Result("TrackingState.RECENTLY_LOST", True, np.eye(4), 0)
        self.stamps.append(stamp_s)
        pose = np.eye(4)
        pose[0, 3] = level
        return Result("TrackingState.OK", True, pose, 100 + level)

    def shutdown(self):
        pass

    def save_trajectory_euroc(self, path):
        with open(path, "w") as stream:
            for number, stamp_s in enumerate(self.stamps):
                stream.write(f"{1e9 * stamp_s:.6f} {number} 0 0 0 0 0 1\\n")

    def save_keyframe_trajectory_tum(self, path):
        with open(path, "w") as stream:
            for stamp_s in self.stamps[::2]:
                stream.write(f"{stamp_s:.6f} 0 0 0 0 0 0 1\\n")
'''


@pytest.fixture
def fake_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a module called pyorbslam3 that this process and its children find first."""
    (tmp_path / "pyorbslam3.py").write_text(STAND_IN)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    return tmp_path


def frames(levels: list[int], interval_s: float = 0.01) -> Iterator[Frame]:
    for index, level in enumerate(levels):
        yield Frame(index + 5, 1.4e9 + interval_s * index, np.full((6, 8), level, np.uint8))


@pytest.mark.usefixtures("fake_package")
def test_a_run_is_read_from_answers_files_and_log() -> None:
    run = OrbSlam3.create().run(frames([0, 1, 203, 4, 5, 9, 6, 202, 8]), CAMERA, seed=0)
    assert [frame.state for frame in run.frames] == [
        "not_initialized", "not_initialized", "tracked", "tracked", "tracked", "lost", "tracked", "tracked", "tracked",
    ]  # fmt: skip
    assert [frame.index for frame in run.frames] == list(range(5, 14))
    assert run.frames[5].reason == "recently_lost"
    assert run.frames[3].inliers == 104
    assert all(frame.elapsed_ms >= 0 for frame in run.frames)
    np.testing.assert_allclose(run.trajectory.timestamps_s - 1.4e9, [0.02, 0.03, 0.04, 0.06, 0.07, 0.08], atol=1e-6)
    np.testing.assert_allclose(run.trajectory.positions_world[:, 0], np.arange(6))
    np.testing.assert_allclose(run.trajectory_before_loops.positions_world[:, 0], [203, 4, 5, 6, 202, 8])
    assert run.keyframe_indices.tolist() == [7, 9, 12]
    assert [frame.index for frame in run.frames if frame.keyframe] == [7, 9, 12]
    assert [(loop.frame, loop.merged_maps) for loop in run.loops] == [(12, False)]
    assert run.maps == 1


@pytest.mark.thorough
@pytest.mark.usefixtures("fake_package")
def test_frames_are_paced() -> None:
    started = time.monotonic()
    OrbSlam3.create(slowdown=2.0).run(frames([5] * 6, interval_s=0.1), CAMERA, seed=0)
    assert time.monotonic() - started >= 1.0


@pytest.mark.thorough
@pytest.mark.usefixtures("fake_package")
def test_a_crash_is_an_error_that_says_where() -> None:
    with pytest.raises(SlamError, match=r"SIGSEGV, frame 7; .*: about"):
        OrbSlam3.create().run(frames([5, 5, 200, 5]), CAMERA, seed=0)


@pytest.mark.thorough
@pytest.mark.usefixtures("fake_package")
def test_running_out_of_memory_is_an_error_that_names_the_limit() -> None:
    with pytest.raises(SlamError, match=r"status 1 \(out of memory: .* memory_mb\), frame 6"):
        OrbSlam3.create().run(frames([5, 205, 5]), CAMERA, seed=0)


@pytest.mark.thorough
@pytest.mark.usefixtures("fake_package")
def test_an_exit_is_an_error_with_its_status() -> None:
    with pytest.raises(SlamError, match="status 3, frame 6"):
        OrbSlam3.create().run(frames([5, 204, 5]), CAMERA, seed=0)


@pytest.mark.thorough
@pytest.mark.usefixtures("fake_package")
def test_a_hang_is_an_error_and_the_child_is_gone() -> None:
    started = time.monotonic()
    with pytest.raises(SlamError, match="within 3 s, frame 6"):
        OrbSlam3.create(answer_timeout_s=3.0).run(frames([5, 201, 5]), CAMERA, seed=0)
    assert time.monotonic() - started < 30


@pytest.mark.thorough
def test_a_package_that_does_not_import_is_unsupported(fake_package: Path) -> None:
    (fake_package / "pyorbslam3.py").write_text("raise ImportError('libEGL.so.1: cannot open shared object file')")
    with pytest.raises(Unsupported, match=r"libEGL.* libgl1 libegl1"):
        OrbSlam3.create().run(frames([5, 5]), CAMERA, seed=0)


@pytest.mark.skipif(importlib.util.find_spec("pyorbslam3") is not None, reason="pyorbslam3 is installed")
def test_a_missing_package_is_unsupported() -> None:
    with pytest.raises(Unsupported, match=r"pip install .*\[orbslam3\]"):
        OrbSlam3.create()


@pytest.mark.thorough
@pytest.mark.usefixtures("fake_package")
def test_frames_of_another_size_are_refused_with_a_reason() -> None:
    given = list(frames([5, 5, 5]))
    given[1] = Frame(6, given[1].timestamp_s, np.zeros((12, 16, 3), np.uint8))
    run = OrbSlam3.create().run(given, CAMERA, seed=0)
    assert run.frames[1].state == "refused"
    assert re.findall(r"\d+x\d+", run.frames[1].reason) == ["16x12", "8x6"]
    assert len(run.trajectory) == 2


@pytest.mark.thorough
@pytest.mark.usefixtures("fake_package")
def test_input_that_cannot_be_used_is_refused() -> None:
    with pytest.raises(SlamError, match="got 1 frame"):
        OrbSlam3.create().run(frames([5]), CAMERA, seed=0)
    with pytest.raises(SlamError, match="analyze-then-compress"):
        OrbSlam3.create().run(frames([5, 5]), CAMERA, seed=0, keyframe_image=lambda _: np.zeros((6, 8), np.uint8))


def test_settings_are_opencv_yaml(tmp_path: Path) -> None:
    camera = Camera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.26, -0.95, -0.005, 0.002, 1.16))
    path = tmp_path / "settings.yaml"
    path.write_text(settings_text(camera, OrbSlam3Params(features=700), 29.7))
    stored = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    for name, value in (("Camera1.fx", 517.3), ("Camera1.k3", 1.16), ("Camera1.p1", -0.005), ("Camera.fps", 30)):
        assert stored.getNode(name).real() == value
    assert stored.getNode("File.version").string() == "1.0"
    assert stored.getNode("ORBextractor.nFeatures").real() == 700
    fisheye = Camera(512, 512, 190.9, 190.9, 254.9, 256.8, (0.003, 0.0007, -0.002, 0.0002, 0.0), "equidistant")
    path.write_text(settings_text(fisheye, OrbSlam3Params(), 20.0))
    stored = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    assert stored.getNode("Camera.type").string() == "KannalaBrandt8"
    assert [stored.getNode(f"Camera1.k{number}").real() for number in (1, 2, 3, 4)] == [0.003, 0.0007, -0.002, 0.0002]
    assert "Camera1.p1" not in path.read_text()
    assert "Camera1.k1" not in settings_text(CAMERA, OrbSlam3Params(), 10.0)


@pytest.mark.skipif(importlib.util.find_spec("pyorbslam3") is None, reason="pyorbslam3 is not installed")
@pytest.mark.real
def test_the_real_one_tracks_a_real_sequence(data_folder: Path) -> None:
    folder = data_folder / "fr3_office_715"
    rows = [line.split() for line in (folder / "rgb.txt").read_text().splitlines() if not line.startswith("#")][:60]
    camera = Camera(640, 480, 535.4, 539.2, 320.1, 247.6)
    given = [
        Frame(i, float(stamp), np.asarray(cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE), dtype=np.uint8))
        for i, (stamp, name) in enumerate(rows)
    ]
    run = OrbSlam3.create().run(given, camera, seed=0)
    assert len(run.frames) == 60
    assert run.maps >= 1
    assert len(run.trajectory) >= 20
    assert len(run.keyframe_indices) >= 2
