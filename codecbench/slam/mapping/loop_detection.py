"""Loop detection: a keyframe shows a known place of its map or of another one (ORB-SLAM VII-A, VII-B)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codecbench.slam import thresholds
from codecbench.slam.features.matching import keep_consistent_rotations, match_by_appearance, match_in_windows
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.geometry.similarity import estimate_similarity, optimize_similarity
from codecbench.slam.geometry.transforms import sim3_compose, sim3_from_parts, sim3_scale
from codecbench.slam.map.map import NONE, Indices, Map
from codecbench.slam.map.projection import project_map_points
from codecbench.slam.places.recognition import PlaceRecognition


@dataclass(frozen=True)
class Loop:
    """A keyframe that shows the place of another keyframe, which may be in another map."""

    keyframe: int
    matched_keyframe: int
    """The keyframe of the place that is seen again."""
    keyframe_from_world: Array
    """Where `keyframe` is in the matched keyframe's map: a similarity (4, 4)."""
    points: Indices
    """The matched side's point that each feature of `keyframe` shows (N,), NONE for none."""
    inliers: int
    """Number of `points`."""


class LoopDetector:
    """Detects places of a map `there` in the keyframes of a map `here`.

    The two are the same map for loops, different ones for merging.
    """

    def __init__(
        self, here: PlaceRecognition, there: PlaceRecognition, camera: Camera, rng: np.random.Generator
    ) -> None:
        self._here = here
        self._there = there
        self._camera = camera
        self._rng = rng
        self._groups: list[tuple[frozenset[int], int]] = []  # covisible candidates, and for how many keyframes in a row

    def detect(self, keyframe: int) -> Loop | None:
        """Return the loop that `keyframe` closes, or would close if the maps were one; None if there is none."""
        for candidate in self._consistent_candidates(keyframe):
            loop = self._verify(keyframe, candidate)
            if loop is not None:
                self._groups = []
                return loop
        return None

    def _consistent_candidates(self, keyframe: int) -> list[int]:
        """Return candidates whose neighborhood was a candidate for the last keyframes too."""
        groups: list[tuple[frozenset[int], int]] = []
        consistent = []
        for candidate in self._here.loop_candidates(keyframe, self._there):
            group = frozenset([candidate, *(int(k) for k in self._there.map.neighbors(candidate)[0])])
            repeats = 1 + max((count for other, count in self._groups if group & other), default=0)
            groups.append((group, repeats))
            if repeats >= thresholds.LOOP_CONSISTENT_KEYFRAMES:
                consistent.append(candidate)
        self._groups = groups
        return consistent

    def _verify(self, keyframe: int, candidate: int) -> Loop | None:
        """Return the loop with `candidate`, if a similarity explains enough matches."""
        matches = self._match_points(keyframe, candidate)
        if len(matches[0]) < thresholds.LOOP_MIN_MATCHES:
            return None
        here, there = self._here.map, self._there.map
        a, b = here.keyframes.features[keyframe], there.keyframes.features[candidate]
        pairs = (
            _points_in_camera(here, keyframe, matches[0]),
            _points_in_camera(there, candidate, matches[1]),
            a.pixels[matches[0]],
            b.pixels[matches[1]],
            here.inverse_sigma2[a.octaves[matches[0]]],
            there.inverse_sigma2[b.octaves[matches[1]]],
            self._camera.intrinsics,
        )
        estimate = estimate_similarity(
            *pairs, self._rng, min_inliers=thresholds.LOOP_MIN_INLIERS,
            iterations=thresholds.LOOP_RANSAC_ITERATIONS,
        )  # fmt: skip
        if estimate is None:
            return None
        similarity, inliers = optimize_similarity(estimate[0], *pairs)
        if int(inliers.sum()) < thresholds.LOOP_MIN_INLIERS:
            return None
        keyframe_from_world = sim3_compose(similarity, there.keyframes.camera_from_world[candidate])
        points, expected = self._project_loop_side(keyframe, candidate, keyframe_from_world)
        projected_matches = int((points >= 0).sum())
        if projected_matches < max(thresholds.LOOP_MIN_PROJECTED, thresholds.LOOP_MIN_PROJECTED_SHARE * expected):
            return None
        return Loop(keyframe, candidate, keyframe_from_world, points, projected_matches)

    def _match_points(self, keyframe: int, candidate: int) -> tuple[Indices, Indices]:
        """Return features of both keyframes, (N,) each, that look alike and both show a map point."""
        here, there = self._here.map.keyframes, self._there.map.keyframes
        a, b = here.features[keyframe], there.features[candidate]
        matches = match_by_appearance(
            a.descriptors, self._here.nodes(keyframe), here.points[keyframe, : len(a)] >= 0,
            b.descriptors, self._there.nodes(candidate), there.points[candidate, : len(b)] >= 0,
            thresholds.HAMMING_LOW, thresholds.LOOP_RATIO,
        )  # fmt: skip
        keep_consistent_rotations(matches, a.angles, b.angles)
        features = np.nonzero(matches >= 0)[0]
        return features, matches[features]

    def _project_loop_side(self, keyframe: int, candidate: int, keyframe_from_world: Array) -> tuple[Indices, int]:
        """Return the loop side's point that each feature of `keyframe` shows (N,), and how many it should show.

        The points are matched by projection.
        """
        features, there = self._here.map.keyframes.features[keyframe], self._there.map
        group = np.concatenate([[candidate], there.neighbors(candidate)[0]])
        projections = project_map_points(
            there, there.points_of(group), rigid_part(keyframe_from_world), self._camera, thresholds.VIEWING_COSINE
        )
        matches = match_in_windows(
            projections.pixels, thresholds.LOOP_WINDOW_PX * there.scale_factors[projections.octaves],
            projections.octaves - 1, projections.octaves + 1, there.points.descriptors[projections.points],
            features, np.ones(len(features), np.bool_), thresholds.HAMMING_LOW,
        )  # fmt: skip
        matched_points = np.full(len(features), NONE, np.int64)
        matched_points[matches[matches >= 0]] = projections.points[matches >= 0]
        return matched_points, len(projections.points)


def _points_in_camera(slam_map: Map, keyframe: int, features: Indices) -> Array:
    """Return the points (N, 3) that a keyframe shows at `features` (N,), in its camera's frame."""
    table = slam_map.keyframes
    pose, points = table.camera_from_world[keyframe], table.points[keyframe, features]
    return np.asarray(slam_map.points.positions[points] @ pose[:3, :3].T + pose[:3, 3])


def rigid_part(similarity: Array) -> Array:
    """Return the rigid motion (4, 4), [R, t / s], that gives the same image as `similarity`, camera from world."""
    scale = sim3_scale(similarity)
    return np.asarray(sim3_from_parts(1.0, similarity[:3, :3] / scale, similarity[:3, 3] / scale))
