"""The orb backend: how codecbench's SLAM is fed and read, and that equal runs are equal."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numba.core import event

from codecbench.core.contracts.errors import SlamError
from codecbench.core.contracts.sequence import Camera, Frame
from codecbench.core.contracts.slam import LoopEvent
from codecbench.plugins.slam_backends import codecbench_slam_backends, orb
from codecbench.plugins.slam_backends.orb import Orb
from codecbench.slam import ClosedLoop, FrameState, FrameTrajectory, MapResult, MergedMaps, Result

pytestmark = pytest.mark.thorough

CAMERA = Camera(640, 480, 535.4, 539.2, 320.1, 247.6, (0.1, 0.0, 0.0, 0.0, 0.0))


class Recorder:
    """Stands in for the System: remembers what it is given, takes every third frame as keyframe."""

    last: Recorder

    def __init__(self, camera: Any, options: Any, seed: int) -> None:
        self.camera, self.options, self.seed = camera, options, seed
        self.images: list[np.ndarray] = []
        self.keyframes: list[np.ndarray | None] = []
        self.states: list[FrameState] = []
        Recorder.last = self

    def process(self, image: np.ndarray, timestamp_s: float, keyframe_image: Callable | None = None) -> FrameState:
        index = len(self.states)
        keyframe = index % 3 == 0
        self.images.append(image)
        if keyframe:
            self.keyframes.append(None if keyframe_image is None else keyframe_image(image))
        self.states.append(FrameState(index, timestamp_s, "tracked", 40 + index, keyframe, 0))
        return self.states[-1]

    def finish(self) -> Result:
        count = len(self.states)
        times = np.array([state.timestamp_s for state in self.states])
        path = FrameTrajectory(np.arange(count), times, np.tile(np.eye(4), (count, 1, 1)))
        found = MapResult(0, path, path, np.arange(0, count, 3), np.zeros((7, 3)))
        loops = (ClosedLoop(4, 1, 33),) if count > 4 else ()
        merges = (MergedMaps(3, 2, 44, 0, 1),) if count > 4 else ()
        return Result(tuple(self.states), loops, (found, found), merges)


def frames(count: int, first: int = 0) -> list[Frame]:
    return [Frame(first + i, 100.0 + 0.1 * i, np.full((480, 640, 3), 10 + i, np.uint8)) for i in range(count)]


def test_the_system_gets_camera_options_seed_and_gray_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(orb.slam, "System", Recorder)
    Orb.create(features=700, levels=6, scale=1.3, loop_closing=False, final_adjustment=False).run(
        frames(3), CAMERA, seed=11
    )
    system = Recorder.last
    assert (system.camera.width, system.camera.fy, system.camera.distortion[0]) == (640, 539.2, 0.1)
    options = system.options
    assert (options.features, options.levels, options.scale_factor) == (700, 6, 1.3)
    assert (options.loop_closing, options.final_bundle_adjustment) == (False, False)
    assert system.seed == 11
    assert all(image.shape == (480, 640) for image in system.images)
    assert system.keyframes == [None]


def test_frames_keep_the_indices_of_their_sequence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(orb.slam, "System", Recorder)
    run = Orb.create().run(frames(7, first=20), CAMERA, seed=0)
    assert [frame.index for frame in run.frames] == list(range(20, 27))
    assert run.keyframe_indices.tolist() == [20, 23, 26]
    assert run.loops == (LoopEvent(23, 22, 44, merged_maps=True), LoopEvent(24, 21, 33))
    assert run.maps == 2
    assert len(run.points_world) == 7
    assert all(frame.elapsed_ms > 0 for frame in run.frames)


def test_analyze_then_compress_gives_mapping_the_decoded_keyframe(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(orb.slam, "System", Recorder)
    asked = []

    def keyframe_image(index: int) -> np.ndarray:
        asked.append(index)
        return np.full((480, 640, 3), 200, np.uint8)

    Orb.create().run(frames(4, first=5), CAMERA, seed=0, keyframe_image=keyframe_image)
    assert asked == [5, 8]
    assert [int(image[0, 0]) for image in Recorder.last.images] == [10, 11, 12, 13]
    assert all(
        image is not None and image.shape == (480, 640) and image[0, 0] == 200 for image in Recorder.last.keyframes
    )


def test_compiling_and_decoding_take_no_time_of_slam(monkeypatch: pytest.MonkeyPatch) -> None:
    seconds = 0.0

    def work(duration_s: float) -> None:
        nonlocal seconds
        seconds += duration_s

    class Working(Recorder):
        def process(self, image: np.ndarray, timestamp_s: float, keyframe_image: Callable | None = None) -> FrameState:
            work(0.25)
            with event.trigger_event("numba:compile"):
                work(100.0)
            return super().process(image, timestamp_s, keyframe_image)

        def finish(self) -> Result:
            work(0.5)
            return super().finish()

    def keyframe_image(index: int) -> np.ndarray:
        work(1000.0)
        with event.trigger_event("numba:compile"):
            work(100.0)
        return np.zeros((480, 640), np.uint8)

    monkeypatch.setattr(orb.slam, "System", Working)
    monkeypatch.setattr(orb.time, "perf_counter", lambda: seconds)
    monkeypatch.setattr(event, "timer", lambda: seconds)
    run = Orb.create().run(frames(3), CAMERA, seed=0, keyframe_image=keyframe_image)
    assert [frame.elapsed_ms for frame in run.frames] == [250.0, 250.0, 750.0]


def test_no_frame_is_an_error() -> None:
    with pytest.raises(SlamError, match="no frame"):
        Orb.create().run([], CAMERA, seed=0)


def test_black_frames_are_never_initialised() -> None:
    run = Orb.create().run([Frame(i, 0.1 * i, np.zeros((480, 640), np.uint8)) for i in range(5)], CAMERA, seed=0)
    assert [frame.state for frame in run.frames] == ["not_initialized"] * 5
    assert all(frame.reason for frame in run.frames)
    assert len(run.trajectory) == len(run.trajectory_before_loops) == run.maps == 0


def test_both_backends_are_offered() -> None:
    specs = {spec.name: spec for spec in codecbench_slam_backends()}
    assert list(specs) == ["orb", "orbslam3"]
    assert specs["orbslam3"].extra == "codecbench[orbslam3]"
    assert specs["orb"].target.endswith(f":{Orb.__name__}")


@pytest.mark.real
def test_real_frames_are_tracked_and_equal_runs_are_equal(data_folder: Path) -> None:
    folder = data_folder / "fr3_office_715"
    rows = [line.split() for line in (folder / "rgb.txt").read_text().splitlines() if not line.startswith("#")][:60]
    camera = Camera(640, 480, 535.4, 539.2, 320.1, 247.6)
    given = [
        Frame(i, float(stamp), np.asarray(cv2.imread(str(folder / name), cv2.IMREAD_GRAYSCALE), dtype=np.uint8))
        for i, (stamp, name) in enumerate(rows)
    ]
    first, second = (Orb.create().run(given, camera, seed=0) for _ in range(2))
    assert len(first.trajectory) >= 30
    assert first.trajectory.world_from_camera.tobytes() == second.trajectory.world_from_camera.tobytes()
    assert [frame.state for frame in first.frames] == [frame.state for frame in second.frames]
