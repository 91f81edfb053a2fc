from __future__ import annotations

import hashlib
import os
import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rendered_scenes import CAMERA, Room, looking, path_pose, position_error

from codecbench.core.contracts.image import gray_from_image
from codecbench.plugins.codecs.jpeg import Jpeg
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.slam import Camera, Options, Result, System
from codecbench.slam.atlas import TrackedMap
from codecbench.slam.features.extractor import FeatureExtractor
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.mapping.initialization import Initializer

pytestmark = pytest.mark.thorough

STEPS = 45


@pytest.fixture(scope="module")
def film() -> list[NDArray[np.uint8]]:
    room = Room()
    return [room.image(path_pose(i)) for i in range(STEPS)]


def run(film: list[NDArray[np.uint8]], **keywords: object) -> Result:
    system = System(CAMERA, Options(features=600), seed=1)
    for i, image in enumerate(film):
        system.process(image, i / 15.0, **keywords)  # type: ignore[arg-type]
    return system.finish()


def error(result: Result) -> float:
    true = np.array([np.linalg.inv(path_pose(i))[:3, 3] for i in result.trajectory.frame_indices])
    return position_error(result.trajectory.world_from_camera[:, :3, 3], true)


def digest(result: Result) -> str:
    arrays = (
        result.trajectory.world_from_camera,
        result.points_world,
        result.trajectory_before_loops.world_from_camera,
    )
    return hashlib.sha256(b"".join(np.ascontiguousarray(a).tobytes() for a in arrays)).hexdigest()


def test_a_walk_is_followed(film: list[NDArray[np.uint8]]) -> None:
    result = run(film)
    states = [frame.state for frame in result.frames]
    first = states.index("tracked")
    assert first <= 15
    assert states[first:] == ["tracked"] * (STEPS - first)
    assert all(frame.reason for frame in result.frames[:first])
    assert len(result.maps) == 1
    assert len(result.trajectory) == STEPS - first
    assert np.allclose(np.linalg.det(result.trajectory.world_from_camera[:, :3, :3]), 1.0)
    assert error(result) < 0.04  # of a path 1.7 long, seen by a coarse camera
    assert len(result.keyframe_indices) >= 3
    assert min(frame.inliers for frame in result.frames[first:]) >= 30


def test_a_camera_that_turns_in_place_gets_a_map_once_it_moves() -> None:
    turning = [looking((-1.0, 0.0, -1.0), 0.3 + 0.0135 * i, 0.25) for i in range(30)]  # for two seconds
    steps = np.arange(1, 41) / 30.0
    moving = [looking((-1.0 + 0.8 * t, 0.1 * np.sin(3.0 * t), -1.0 + 0.4 * t), 0.7, 0.25) for t in steps]
    room = Room()
    result = run([room.image(pose) for pose in turning + moving])
    states = [frame.state for frame in result.frames]
    assert states[:30] == ["not_initialized"] * 30
    assert sum("a rotation explains" in frame.reason for frame in result.frames[:30]) >= 25
    assert states[-25:] == ["tracked"] * 25
    assert len(result.maps) == 1
    true = np.array([np.linalg.inv((turning + moving)[i])[:3, 3] for i in result.trajectory.frame_indices])
    assert position_error(result.trajectory.world_from_camera[:, :3, 3], true) < 0.03


def test_a_map_that_is_dropped_leaves_no_poses_and_another_one_starts(
    film: list[NDArray[np.uint8]], monkeypatch: pytest.MonkeyPatch
) -> None:
    started = [frame.state for frame in run(film).frames].index("tracked")
    dropping = started + 4

    def rejection_reason(self: TrackedMap, frame: TrackingFrame) -> str:
        return "a false start" if frame.index == dropping else ""

    monkeypatch.setattr(TrackedMap, "rejection_reason", rejection_reason)
    result = run(film)
    assert [(frame.state, frame.reason) for frame in result.frames[started:dropping]] == [
        ("not_initialized", "a false start")
    ] * 4
    assert result.frames[dropping].state == "not_initialized"
    again = [frame.state for frame in result.frames].index("tracked")
    assert again > dropping
    assert [built.index for built in result.maps] == [1]
    assert result.trajectory.frame_indices[0] == again
    assert error(result) < 0.04


def test_a_false_start_before_a_flat_wall_under_coarse_coding_is_dropped() -> None:
    """Kept, its map follows a fifth of the frames with a scale that shrinks to a tenth."""
    wall = Synthetic.create(world="slow_start", severity=0.5).open()
    seen, true, coder = wall.camera, wall.ground_truth, Jpeg.create(quality=10)
    assert seen is not None
    assert true is not None
    system = System(Camera(seen.width, seen.height, seen.fx, seen.fy, seen.cx, seen.cy))
    for frame in wall:
        assert frame.timestamp_s is not None
        system.process(gray_from_image(coder.decode(coder.encode(frame.image))), frame.timestamp_s)
    result = system.finish()
    assert sum(frame.reason.startswith("the map leaves ") for frame in result.frames) >= 2
    nearest = np.abs(true.timestamps_s - result.trajectory.timestamps_s[:, None]).argmin(axis=1)
    path = true.world_from_camera[nearest, :3, 3]
    assert position_error(result.trajectory.world_from_camera[:, :3, 3], path) < 0.05  # meters


def test_runs_are_equal_to_the_last_bit_in_any_process(film: list[NDArray[np.uint8]]) -> None:
    expected = digest(run(film))
    assert digest(run(film)) == expected
    program = (
        "import cv2; cv2.setNumThreads(2)\n"
        "from test_system import *\n"
        "room = Room()\n"
        "print(digest(run([room.image(path_pose(i)) for i in range(STEPS)])))\n"
    )
    folders = Path(__file__).parent, Path(__file__).parents[1] / "support"
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=300,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))},
    )  # fmt: skip
    assert done.stdout.split()[-1] == expected


def test_color_is_rgb_and_seen_as_its_luma(film: list[NDArray[np.uint8]]) -> None:
    """The film under a light that turns from reddish to bluish: read with blue first, its luma would be another."""
    tint = np.linspace(1.0, 0.3, CAMERA.width)
    color = [np.stack([image * tint, image * 0.9, image * tint[::-1]], axis=-1).astype(np.uint8) for image in film]
    expected = digest(run([gray_from_image(image) for image in color]))
    assert len(run(color).trajectory) >= 30
    assert digest(run(color)) == expected
    assert digest(run([np.ascontiguousarray(image[:, :, ::-1]) for image in color])) != expected


def test_lens_distortion_is_undone() -> None:
    bent = Camera(320, 240, 260.0, 262.0, 158.5, 121.0, (-0.25, 0.08, 0.001, -0.001))
    x, y = np.meshgrid(np.arange(320.0), np.arange(240.0))
    straight = bent.undistort(np.column_stack([x.ravel(), y.ravel()])).reshape(240, 320, 2).astype(np.float32)
    wide = Camera(520, 440, 260.0, 262.0, 258.5, 221.0)
    room = Room()
    system = System(bent, Options(features=600))
    for i in range(30):
        image = room.image(path_pose(i), wide)
        system.process(cv2.remap(image, straight[..., 0] + 100.0, straight[..., 1] + 100.0, cv2.INTER_LINEAR), i / 15.0)
    result = system.finish()
    assert len(result.trajectory) >= 15
    assert error(result) < 0.05


def test_a_fisheye_of_150_degrees_is_undone() -> None:
    fisheye = Camera(320, 320, 110.0, 110.0, 158.5, 161.0, (0.02, -0.01, 0.004, -0.001), "equidistant")
    x, y = np.meshgrid(np.arange(320.0), np.arange(320.0))
    straight = fisheye.undistort(np.column_stack([x.ravel(), y.ravel()])).reshape(320, 320, 2).astype(np.float32)
    wide = Camera(1320, 1320, 160.0, 160.0, 659.5, 659.5)
    places = (straight - fisheye.intrinsics[2:].astype(np.float32)) * np.float32(160.0 / 110.0) + np.float32(659.5)
    room = Room()
    system = System(fisheye, Options(features=600))
    for i in range(30):
        image = room.image(path_pose(i), wide)
        system.process(cv2.remap(image, places[..., 0], places[..., 1], cv2.INTER_LINEAR, borderValue=90), i / 15.0)
    result = system.finish()
    assert len(result.trajectory) >= 15
    assert error(result) < 0.05


def test_keyframes_come_from_the_decoded_image(film: list[NDArray[np.uint8]]) -> None:
    asked: list[int] = []

    def decoded(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        asked.append(len(asked))
        return np.asarray(
            cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 85])[1], 0), dtype=np.uint8
        )

    result = run(film, keyframe_image=decoded)
    made = sum(frame.keyframe for frame in result.frames)
    assert made >= 3
    assert len(asked) >= made + 1  # and the first frame of the map
    assert digest(result) != digest(run(film))
    assert error(result) < 0.05


def test_a_lossless_codec_for_keyframes_changes_nothing(film: list[NDArray[np.uint8]]) -> None:
    assert digest(run(film, keyframe_image=lambda image: image)) == digest(run(film))


def test_no_frame_bears_all_steps_of_a_keyframe(film: list[NDArray[np.uint8]], monkeypatch: pytest.MonkeyPatch) -> None:
    """It is inserted in its own frame, settled in the next, and its place is looked for in the one after that, or
    before the next keyframe."""
    done: list[tuple[str, int]] = []
    for name in ("insert", "refine_neighborhood", "close_loop"):
        monkeypatch.setattr(TrackedMap, name, noted(getattr(TrackedMap, name), name, done))
    system, at = System(CAMERA, Options(features=600), seed=1), []
    for i, image in enumerate(film):
        begun = len(done)
        state = system.process(image, i / 15.0)
        at += [(name, keyframe, i) for name, keyframe in done[begun:]]
        if i >= 20 and state.keyframe:
            break
    steps = [name for name, _, _ in at]
    inserted = [(keyframe, i) for name, keyframe, i in at if name == "insert"]
    settled = [(keyframe, i - 1) for name, keyframe, i in at if name == "refine_neighborhood"]
    assert len(inserted) >= 2
    assert settled == inserted[:-1]
    assert steps[-1] == "insert"
    assert all(steps[k : k + 3] == ["insert", "refine_neighborhood", "close_loop"] for k in range(0, len(steps) - 1, 3))
    result = system.finish()
    assert [name for name, _ in done[-2:]] == ["refine_neighborhood", "close_loop"]
    assert result.trajectory.frame_indices[-1] == result.keyframe_indices[-1] == at[-1][2]


def noted(step: Callable[..., Any], name: str, done: list[tuple[str, int]]) -> Callable[..., Any]:
    """A method of TrackedMap that also notes its name and the keyframe."""

    def noting(tracked_map: TrackedMap, of: Any) -> Any:
        found = step(tracked_map, of)
        done.append((name, int(getattr(of, "reference", of))))
        return found

    return noting


def test_keypoints_give_what_their_frames_give(film: list[NDArray[np.uint8]]) -> None:
    extractor, system = FeatureExtractor(CAMERA, Options(features=600)), System(CAMERA, Options(features=600), seed=1)
    for i, image in enumerate(film):
        system.process_keypoints(extractor.find(image), i / 15.0)
    assert digest(system.finish()) == digest(run(film))


def test_more_keypoints_than_the_options_allow_are_refused(film: list[NDArray[np.uint8]]) -> None:
    many = FeatureExtractor(CAMERA, Options(features=600)).find(film[0])
    with pytest.raises(ValueError, match=rf"^{len(many)} keypoints; .* 100: "):
        System(CAMERA, Options(features=100)).process_keypoints(many, 0.0)


def test_after_a_blackout_the_camera_is_found_again(film: list[NDArray[np.uint8]]) -> None:
    black = np.zeros_like(film[0])
    room = Room()
    longer = [room.image(path_pose(2 * i)) for i in range(60)]  # a map large enough to be worth coming back to
    result = run([*longer, *[black] * 5, *longer[-8:]])
    states = [frame.state for frame in result.frames]
    assert states[60:65] == ["lost"] * 5
    assert result.frames[61].reason == "0 features"
    assert states[-5:] == ["tracked"] * 5
    assert len(result.maps) == 1


def test_a_lost_camera_starts_a_new_map_at_once_and_keeps_the_old(film: list[NDArray[np.uint8]]) -> None:
    other = [np.ascontiguousarray(image[:, ::-1]) for image in film]  # another place, from one frame to the next
    started = [frame.state for frame in run(other).frames].index("tracked")
    result = run([*film, *other])
    states = [frame.state for frame in result.frames]
    assert states[STEPS : STEPS + started] == ["lost"] * started
    assert states[STEPS + started :] == ["tracked"] * (STEPS - started)
    assert sorted(found.index for found in result.maps) == [0, 1]
    assert {frame.map_index for frame in result.frames if frame.state == "tracked"} == {0, 1}
    assert min(len(found.trajectory) for found in result.maps) > 10


def test_what_may_start_a_map_shows_no_points_of_the_last_one(
    film: list[NDArray[np.uint8]], monkeypatch: pytest.MonkeyPatch
) -> None:
    shown, add = [], Initializer.add

    def noting(self: Initializer, frame: TrackingFrame, map_index: int) -> Any:
        shown.append(len(frame.matched_features))
        return add(self, frame, map_index)

    monkeypatch.setattr(Initializer, "add", noting)
    monkeypatch.setattr(
        TrackedMap, "rejection_reason", lambda self, frame: "a false start" if frame.index == 30 else ""
    )
    result = run([*film, film[0][:, ::-1]])
    assert [result.frames[index].state for index in (29, 30, STEPS)] == ["not_initialized", "not_initialized", "lost"]
    assert set(shown) == {0}


def test_a_camera_found_again_forgets_the_start_that_it_tried(film: list[NDArray[np.uint8]]) -> None:
    """The strange frame waits for a second view; once the camera was found again, the next strange one waits anew."""
    strange = np.ascontiguousarray(film[0][:, ::-1])
    result = run([*film[:40], strange, *film[40:43], strange])
    assert [frame.state for frame in result.frames[40:]] == ["lost", "tracked", "tracked", "tracked", "lost"]
    assert [result.frames[index].reason.split()[0] for index in (40, 44)] == ["waiting"] * 2


@pytest.mark.parametrize("filler", [0, 255])
def test_frames_without_texture_never_start(filler: int) -> None:
    system = System(CAMERA)
    for i in range(4):
        state = system.process(np.full((240, 320), filler, np.uint8), float(i))
        assert state.state == "not_initialized"
        assert state.reason == "0 features"
    assert len(system.finish().trajectory) == 0


def test_repeated_frames_and_gaps_are_survived(film: list[NDArray[np.uint8]]) -> None:
    system = System(CAMERA, Options(features=600))
    clock = 0.0
    for i, image in enumerate(film):
        for _ in range(3 if i in (5, 25, 30) else 1):
            clock += 2.0 if i == 35 else 1.0 / 15.0
            system.process(image, clock)
    result = system.finish()
    assert [frame.state for frame in result.frames][-8:] == ["tracked"] * 8
    assert np.isfinite(result.trajectory.world_from_camera).all()


def test_frames_that_cannot_be_used_are_refused_with_the_reason(film: list[NDArray[np.uint8]]) -> None:
    system = System(CAMERA)
    system.process(film[0], 1.0)
    assert re.findall(r"\d+x\d+", system.process(film[1][:-1], 2.0).reason) == ["320x239", "320x240"]
    assert system.process(film[1], 1.0).state == "refused"
    assert system.process(film[1], float("nan")).state == "refused"
    assert system.process(film[1], 1.1).state == "not_initialized"
    for wrong in (film[0].astype(np.float32), np.zeros((240, 320, 2), np.uint8), "no image"):
        with pytest.raises(TypeError, match="image"):
            system.process(wrong, 5.0)  # type: ignore[arg-type]


def test_the_callers_number_of_threads_is_left_alone(film: list[NDArray[np.uint8]]) -> None:
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)
    try:
        System(CAMERA).process(film[0], 0.0)
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)


def test_options_out_of_range_are_refused() -> None:
    for wrong in ({"features": 10}, {"levels": 0}, {"scale_factor": 1.0}):
        with pytest.raises(ValueError, match="Options"):
            Options(**wrong)  # type: ignore[arg-type]
