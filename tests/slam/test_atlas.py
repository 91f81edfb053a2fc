"""Several maps in one run: when they become one, and where a lost camera is looked for."""

from __future__ import annotations

import gc
import hashlib
import weakref
from collections.abc import Iterable

import numpy as np
import pytest
from numpy.typing import NDArray
from rendered_scenes import CAMERA, features_at, position_error

from codecbench.core.contracts.image import gray_from_image
from codecbench.plugins.datasets.synthetic.dataset import SyntheticParams, SyntheticSequence
from codecbench.slam import Camera, MergedMaps, Options, Result, System, atlas, thresholds
from codecbench.slam.atlas import Atlas, TrackedMap
from codecbench.slam.map.frame import TrackingFrame

pytestmark = pytest.mark.thorough

STRIDE = 2
BLACK = range(60, 120)  # four seconds; the round ends where it began at 170


class Walk:
    """The embedded room at 15 Hz."""

    def __init__(self) -> None:
        self.sequence = SyntheticSequence(SyntheticParams(stride=STRIDE))
        self.images = [gray_from_image(self.sequence.read(i).image) for i in range(len(self.sequence))]
        camera = self.sequence.camera
        assert camera is not None
        self.camera = Camera(camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)

    def run(self, black: Iterable[int] = (), loop_closing: bool = True) -> Result:
        system = System(self.camera, Options(loop_closing=loop_closing))
        for i, image in enumerate(self.images):
            system.process(np.zeros_like(image) if i in black else image, float(self.sequence.timestamps_s[i]))
        return system.finish()

    def error_m(self, result: Result, poses: NDArray[np.float64] | None = None) -> float:
        assert self.sequence.ground_truth is not None
        true = self.sequence.ground_truth.world_from_camera[result.trajectory.frame_indices, :3, 3]
        return position_error((result.trajectory.world_from_camera if poses is None else poses)[:, :3, 3], true)


@pytest.fixture(scope="module")
def walk() -> Walk:
    return Walk()


@pytest.fixture(scope="module")
def broken(walk: Walk) -> Result:
    return walk.run(BLACK)


def test_two_maps_of_one_room_become_one_as_good_as_the_unbroken_run(walk: Walk, broken: Result) -> None:
    whole = walk.run()
    assert (len(whole.maps), whole.merges) == (1, ())
    (merged,) = broken.merges
    assert (merged.map_index, merged.gone_map_index) == (0, 1)
    assert merged.frame_index > 150
    assert merged.matched_frame_index < 20
    assert merged.inliers >= thresholds.LOOP_MIN_PROJECTED
    assert [found.index for found in broken.maps] == [0]
    assert {frame.map_index for frame in broken.frames} == {0}
    tracked = {frame.index for frame in broken.frames if frame.state == "tracked"}
    assert broken.trajectory.frame_indices.tolist() == sorted(tracked)
    assert len(tracked) > 0.95 * (len(walk.images) - len(BLACK))
    assert (np.diff(broken.keyframe_indices) > 0).all()
    assert walk.error_m(broken) < 1.5 * walk.error_m(whole)


def test_as_tracked_both_parts_stand_where_they_met(walk: Walk, broken: Result) -> None:
    """Nothing of the second map's scale or place is left in the poses as tracked, and no correction is in them yet."""
    tracked = broken.trajectory_before_loops.world_from_camera
    assert len(tracked) == len(broken.trajectory)
    assert np.allclose(np.linalg.det(tracked[:, :3, :3]), 1.0)
    assert walk.error_m(broken) < walk.error_m(broken, tracked) < 0.03


def test_merging_is_equal_to_the_last_bit(walk: Walk, broken: Result) -> None:
    def digest(result: Result) -> str:
        arrays = result.trajectory.world_from_camera, result.points_world
        return hashlib.sha256(b"".join(array.tobytes() for array in arrays)).hexdigest()

    assert digest(walk.run(BLACK)) == digest(broken)


def test_without_loop_closing_maps_stay_apart(walk: Walk) -> None:
    apart = walk.run(BLACK, loop_closing=False)
    assert len(apart.maps) == 2
    assert apart.merges == ()
    assert {frame.map_index for frame in apart.frames if frame.state == "tracked"} == {0, 1}


def test_a_map_of_few_keyframes_is_left_alone(walk: Walk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(thresholds, "SMALL_MAP_KEYFRAMES", 1000)
    assert len(walk.run(BLACK).maps) == 2


def test_a_map_that_became_part_of_another_is_freed(walk: Walk, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = []
    absorb = TrackedMap.absorb

    def watched(self: TrackedMap, other: TrackedMap, seen: object) -> None:
        gone.extend([weakref.ref(other), weakref.ref(other.map)])
        absorb(self, other, seen)  # type: ignore[arg-type]

    monkeypatch.setattr(TrackedMap, "absorb", watched)
    system = System(walk.camera)
    for i, image in enumerate(walk.images):
        system.process(np.zeros_like(image) if i in BLACK else image, float(walk.sequence.timestamps_s[i]))
    gc.collect()
    assert [reference() for reference in gone] == [None, None]


class Lost:
    """A map in which nothing is found; it notes where the camera was looked for."""

    def __init__(self, number: int, tried: list[tuple[int, int]], inliers: int = 0) -> None:
        self.number, self.tried, self.inliers = number, tried, inliers
        self.places = number

    def relocalize(self, frame: TrackingFrame, keyframe: int) -> int:
        self.tried.append((self.number, keyframe))
        return self.inliers if keyframe == 2 else 0


@pytest.fixture
def frame() -> TrackingFrame:
    """One without a feature."""
    return TrackingFrame.of(0, 0.0, features_at(np.empty((0, 2)), np.empty((0, 4), np.uint64)))


def many_maps(monkeypatch: pytest.MonkeyPatch, tried: list[tuple[int, int]], inliers: int = 0) -> Atlas:
    """Five maps, the second active; the frame looks like four keyframes of each."""
    maps = Atlas(CAMERA, np.random.default_rng(0))
    maps.maps = [Lost(number, tried, inliers) for number in range(5)]  # type: ignore[misc]
    maps.active = maps.maps[1]
    found = [(which, keyframe) for keyframe in range(4) for which in range(5)]
    monkeypatch.setattr(atlas, "relocalization_candidates", lambda features, places: found)
    return maps


def test_a_lost_camera_is_looked_for_in_all_maps_within_bounds(
    monkeypatch: pytest.MonkeyPatch, frame: TrackingFrame
) -> None:
    tried: list[tuple[int, int]] = []
    maps = many_maps(monkeypatch, tried)
    assert maps.relocalize(frame) == 0
    assert len(tried) == thresholds.RELOCALIZATION_CANDIDATES
    assert [number for number, _ in tried[:5]] == [1, 0, 2, 3, 4]  # the active map first
    assert maps.active is maps.maps[1]


def test_where_the_camera_is_found_it_goes_on(monkeypatch: pytest.MonkeyPatch, frame: TrackingFrame) -> None:
    tried: list[tuple[int, int]] = []
    maps = many_maps(monkeypatch, tried, inliers=70)
    monkeypatch.setattr(thresholds, "RELOCALIZATION_CANDIDATES", 20)
    maps.active = maps.maps[3]
    assert maps.relocalize(frame) == 70
    assert tried[-1] == (3, 2)
    maps.active = None
    assert maps.relocalize(frame) == 70
    assert maps.active is maps.maps[0]


def test_what_was_in_a_map_is_in_what_that_map_became() -> None:
    maps = Atlas(CAMERA, np.random.default_rng(0))
    maps.merges = [MergedMaps(90, 3, 50, 2, 4), MergedMaps(120, 8, 50, 0, 2), MergedMaps(150, 9, 50, 1, 3)]
    assert [maps.surviving_index(index) for index in range(5)] == [0, 1, 0, 1, 0]
