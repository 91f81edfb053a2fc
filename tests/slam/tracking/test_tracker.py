from __future__ import annotations

import numpy as np
import pytest
from map_scenes import build_map, observe_scene
from numpy.typing import NDArray
from rendered_scenes import CAMERA, Floats, features_at, looking, random_descriptors

from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.transforms import se3_inverse, se3_log
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import NONE, Map
from codecbench.slam.tracking.tracker import Tracker

pytestmark = pytest.mark.thorough

KEYFRAMES = [looking((0.15 * i, 0.02 * i, 0.0), 0.01 * i) for i in range(5)]
POINTS = 400


class Scene:
    """A cloud of points, a map of it from five places, and frames of it from anywhere."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.points = rng.uniform([-3.5, -2.5, 4.0], [3.5, 2.5, 8.0], (POINTS, 3))
        self.descriptors = random_descriptors(rng, POINTS)
        self.map: Map = build_map(KEYFRAMES, self.points, self.descriptors)[0]
        self.map.remove_points(np.nonzero(self.map.points.observation_counts[:POINTS] < 2)[0])

    def frame(self, pose: Floats, time_s: float, noise_px: float = 0.0) -> tuple[TrackingFrame, NDArray[np.int64]]:
        """A frame that knows neither pose nor points, and what its features show."""
        seen, shown = observe_scene(pose, self.points, self.descriptors)
        pixels = seen.features.pixels + self.rng.normal(0.0, noise_px, (len(shown), 2)) * (noise_px > 0.0)
        return TrackingFrame.of(int(100 * time_s), time_s, features_at(pixels, self.descriptors[shown])), shown

    def tracker(self, camera: Camera = CAMERA) -> Tracker:
        """A tracker that stands at the last keyframe and looks on through `camera`."""
        frame, shown = self.frame(KEYFRAMES[-1], 0.0)
        frame.camera_from_world = KEYFRAMES[-1].copy()
        frame.points = np.where(self.map.points.alive[shown], shown, NONE)
        frame.reference = len(KEYFRAMES) - 1
        tracker = Tracker(self.map, camera)
        tracker.start(frame)
        return tracker


@pytest.fixture
def scene(rng: np.random.Generator) -> Scene:
    return Scene(rng)


def next_pose(step: float) -> Floats:
    """The keyframes' path, continued; `step` in keyframes after the last."""
    i = 4.0 + step
    return looking((0.15 * i, 0.02 * i, 0.0), 0.01 * i)


def test_pose_and_points_are_exact_without_noise(scene: Scene) -> None:
    tracker = scene.tracker()
    frame, shown = scene.frame(next_pose(0.3), 0.1)
    inliers = tracker.track(frame)
    known = scene.map.points.alive[shown]
    assert np.abs(frame.camera_from_world - next_pose(0.3)).max() < 1e-8
    assert (frame.points[known] == shown[known]).mean() > 0.95
    assert (frame.points[~known] == NONE).all()
    assert inliers == len(frame.matched_features)
    assert tracker.last is frame
    assert frame.reference in (3, 4)  # both show nearly all that it shows


def test_noise_bounds_the_error(scene: Scene) -> None:
    frame, _ = scene.frame(next_pose(0.3), 0.1, noise_px=0.5)
    inliers = scene.tracker().track(frame)
    assert inliers > 100
    assert np.abs(frame.camera_from_world[:3, :3] - next_pose(0.3)[:3, :3]).max() < 0.003
    assert np.abs(frame.camera_from_world[:3, 3] - next_pose(0.3)[:3, 3]).max() < 0.02


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize(("turn_deg", "expected"), [(2.9, True), (3.8, False)])
def test_an_unforeseen_turn_is_followed_up_to_an_angle_at_any_size(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, scale: float, turn_deg: float, expected: bool
) -> None:
    """The wide window is 3.2 degrees; nothing but it may help."""
    monkeypatch.setattr(Tracker, "_track_by_keyframe", lambda *_: False)
    numbers = (260.0, 262.0, 158.5, 121.0)
    tracker = scene.tracker(Camera(round(320 * scale), round(240 * scale), *(scale * number for number in numbers)))
    pose = looking((0.6, 0.08, 0.0), 0.04 + np.deg2rad(turn_deg))
    seen, shown = observe_scene(pose, scene.points, scene.descriptors)
    frame = TrackingFrame.of(1, 0.1, features_at(seen.features.pixels * scale, scene.descriptors[shown]))
    assert (tracker.track(frame) > 0) == expected


def test_a_picture_shown_again_says_nothing_of_the_motion(scene: Scene) -> None:
    """A camera moves on by ten pixels a frame, and every second frame shows the one before."""
    tracker = scene.tracker()
    tracker._track_by_keyframe = lambda _: False  # type: ignore[method-assign]
    tracker._velocity, tracker._interval_s = np.asarray(se3_log(next_pose(1.0) @ se3_inverse(next_pose(0.0)))), 1.0
    for step in (1, 3, 5):
        moved, again = scene.frame(next_pose(step), step)[0], scene.frame(next_pose(step), step + 1.0)[0]
        assert tracker.track(moved) > 100
        assert tracker.track(again) == len(moved.matched_features)
        assert tracker.last is moved
        assert np.array_equal(again.camera_from_world, moved.camera_from_world)
        assert np.array_equal(again.points, moved.points)


def test_steady_motion_is_predicted(scene: Scene) -> None:
    tracker = scene.tracker()
    for step in (1, 2, 3):  # each moves the points by ten pixels, and all three by more than the windows
        frame, _ = scene.frame(next_pose(0.8 * step), 0.1 * step)
        assert tracker.track(frame) > 50
        assert np.abs(frame.camera_from_world - next_pose(0.8 * step)).max() < 1e-8


def test_a_leap_is_bridged_by_appearance(scene: Scene) -> None:
    leap = looking((0.9, 0.1, 0.3), -0.25, 0.1)  # by 70 pixels
    frame, shown = scene.frame(leap, 0.1)
    assert scene.tracker().track(frame) >= 30
    assert np.abs(frame.camera_from_world - leap).max() < 1e-7
    matched = frame.matched_features
    assert np.array_equal(frame.points[matched], shown[matched])


def test_features_that_lie_do_no_harm(scene: Scene) -> None:
    frame, shown = scene.frame(next_pose(0.3), 0.1)
    liars = scene.rng.choice(len(shown), len(shown) // 5, replace=False)
    pixels = frame.features.pixels.copy()
    pixels[liars] += scene.rng.choice([-1.0, 1.0], (len(liars), 2)) * scene.rng.uniform(5.0, 9.0, (len(liars), 2))
    wrong = TrackingFrame.of(1, 0.1, features_at(pixels, frame.features.descriptors))
    assert scene.tracker().track(wrong) >= 30
    assert np.abs(wrong.camera_from_world - next_pose(0.3)).max() < 1e-7
    assert (wrong.points[liars] == NONE).all()


def test_an_unknown_view_is_lost_and_changes_nothing(scene: Scene) -> None:
    tracker = scene.tracker()
    last = tracker.last
    frame, shown = scene.frame(next_pose(0.3), 0.1)
    strange = TrackingFrame.of(1, 0.1, features_at(frame.features.pixels, random_descriptors(scene.rng, len(shown))))
    assert tracker.track(strange) == 0
    assert tracker.last is last
    assert tracker.track(TrackingFrame.of(2, 0.2, features_at(np.empty((0, 2)), np.empty((0, 4), np.uint64)))) == 0


def test_points_count_the_frames_that_should_and_do_show_them(scene: Scene) -> None:
    table = scene.map.points
    visible, found = table.visible_counts.copy(), table.found_counts.copy()
    frame, _ = scene.frame(next_pose(0.3), 0.1)
    hidden = np.arange(0, len(frame.features), 3)
    descriptors = frame.features.descriptors.copy()
    descriptors[hidden] = random_descriptors(scene.rng, len(hidden))
    tracker = scene.tracker()
    tracker.track(TrackingFrame.of(1, 0.1, features_at(frame.features.pixels, descriptors)))
    assert tracker.last is not None
    shown = tracker.last.points[tracker.last.matched_features]
    assert (table.found_counts - found)[shown].tolist() == [1] * len(shown)
    assert (table.found_counts - found).sum() == len(shown)
    assert ((table.visible_counts - visible) >= (table.found_counts - found)).all()
    assert (table.visible_counts - visible).max() == 1
    assert (table.visible_counts - visible).sum() > 1.2 * len(shown)


def test_points_that_were_merged_are_followed(scene: Scene) -> None:
    tracker = scene.tracker()
    assert tracker.last is not None
    frame, shown = scene.frame(next_pose(0.3), 0.1)
    old = np.intersect1d(tracker.last.points[tracker.last.matched_features], shown)[0]
    new = scene.map.points.add(scene.map.points.positions[old][None], 4, 5)
    scene.map.replace_points(np.array([old]), new)
    scene.map.refresh_points(new)
    tracker.track(frame)
    assert frame.points[shown == old].tolist() == new.tolist()
