from __future__ import annotations

import re

import numpy as np
import pytest
from map_scenes import FACTORS
from numpy.typing import NDArray
from rendered_scenes import CAMERA, features_at, random_descriptors, two_views

from codecbench.slam import thresholds
from codecbench.slam.geometry.transforms import se3_exp
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import Map
from codecbench.slam.mapping.initialization import Initializer
from codecbench.slam.mapping.trial import Trial

pytestmark = pytest.mark.thorough

Floats = NDArray[np.float64]


class Scene:
    """A map of 300 points from two views, and later views of them: as they are, or as a camera that turns sees them."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._views = two_views(rng, noise_px=0.3)
        self._descriptors = random_descriptors(rng, 300)
        initializer = Initializer(CAMERA, FACTORS, 300, np.random.default_rng(0))
        for index, pixels in enumerate((self._views.pixels_a, self._views.pixels_b)):
            frame = TrackingFrame.of(index, 0.1 * index, features_at(pixels, self._descriptors))
            started = initializer.add(frame, 0)
        assert not isinstance(started, str)
        self.map: Map = started[0]

    def frame(self, still: bool, count: int = 300) -> TrackingFrame:
        """A frame of so many matches. The map believes it a little beyond the second view, where it was unless the
        camera stood `still` and only turned."""
        second = self.map.pose(1)
        believed = np.asarray(se3_exp(np.array([0.0, 0.0, 0.0, 0.01, 0.0, 0.0]))) @ second
        believed[:3, 3] *= 1.2
        points = self._views.points
        if still:
            pixels = CAMERA.project(points @ believed[:3, :3].T)
        else:
            scale = np.linalg.norm(self._views.b_from_a[:3, 3]) / np.linalg.norm(second[:3, 3])
            pixels = CAMERA.project(points @ believed[:3, :3].T + scale * believed[:3, 3])
        pixels = pixels + self._rng.normal(0.0, 0.3, (300, 2))
        frame = TrackingFrame.of(2, 0.2, features_at(pixels[:count], self._descriptors[:count]))
        frame.camera_from_world = believed
        return frame


def trial(scene: Scene) -> Trial:
    return Trial(scene.map, CAMERA, np.random.default_rng(0))


def test_a_map_that_explains_what_follows_stays(rng: np.random.Generator) -> None:
    scene = Scene(rng)
    judge = trial(scene)
    assert [judge.rejection_reason(scene.frame(still=False)) for _ in range(3)] == [""] * 3


def test_a_map_is_dropped_where_a_rotation_explains_what_follows(rng: np.random.Generator) -> None:
    scene = Scene(rng)
    objection = trial(scene).rejection_reason(scene.frame(still=True))
    assert (share := re.match(r"the map leaves (\d+) %", objection))
    assert int(share[1]) > 100 * thresholds.TRIAL_MISFIT


def test_what_a_map_explained_before_speaks_for_it(rng: np.random.Generator) -> None:
    scene = Scene(rng)
    judge = trial(scene)
    for _ in range(8):
        assert not judge.rejection_reason(scene.frame(still=False))
    assert not judge.rejection_reason(scene.frame(still=True))


@pytest.mark.parametrize("matches", [99, 100])
def test_with_fewer_matches_than_a_start_takes_the_trial_ends(rng: np.random.Generator, matches: int) -> None:
    scene = Scene(rng)
    judge = trial(scene)
    assert bool(judge.rejection_reason(scene.frame(True, matches))) == (matches == thresholds.INIT_MIN_MATCHES)
    assert bool(judge.rejection_reason(scene.frame(True))) == (matches == thresholds.INIT_MIN_MATCHES)


def test_a_trial_ends_after_so_many_frames(rng: np.random.Generator) -> None:
    scene = Scene(rng)
    judge = trial(scene)
    for _ in range(thresholds.TRIAL_FRAMES):
        judge.rejection_reason(scene.frame(still=False))
    for _ in range(30):
        assert not judge.rejection_reason(scene.frame(still=True))
