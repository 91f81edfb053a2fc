"""Seeing that a keyframe shows a place that the map already has (ORB-SLAM VII-A, VII-B)."""

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
    """`keyframe` shows the place of `matched`: `keyframe_from_world` (4, 4) is the similarity that says where it is
    seen from there; `points` (N,), by feature, the loop side's points that it shows; `inliers` their number."""

    keyframe: int
    matched: int
    keyframe_from_world: Array
    points: Indices
    inliers: int


class LoopDetector:
    """Watches the keyframes of one map for loops."""

    def __init__(self, slam_map: Map, camera: Camera, places: PlaceRecognition, rng: np.random.Generator) -> None:
        self._map = slam_map
        self._camera = camera
        self._places = places
        self._rng = rng
        self._groups: list[tuple[frozenset[int], int]] = []  # covisible candidates, and how long they have held

    def detect(self, keyframe: int) -> Loop | None:
        """The loop that `keyframe` closes, if it does."""
        for candidate in self._consistent_candidates(keyframe):
            loop = self._verify(keyframe, candidate)
            if loop is not None:
                self._groups = []
                return loop
        return None

    def _consistent_candidates(self, keyframe: int) -> list[int]:
        """Candidates whose neighbourhood was a candidate for the last keyframes too."""
        groups: list[tuple[frozenset[int], int]] = []
        consistent = []
        for candidate in self._places.loop_candidates(keyframe):
            group = frozenset([candidate, *(int(k) for k in self._map.neighbors(candidate)[0])])
            held = 1 + max((count for other, count in self._groups if group & other), default=0)
            groups.append((group, held))
            if held >= thresholds.LOOP_CONSISTENT_KEYFRAMES:
                consistent.append(candidate)
        self._groups = groups
        return consistent

    def _verify(self, keyframe: int, candidate: int) -> Loop | None:
        """The loop with `candidate`, if a similarity explains enough matches."""
        matches = self._match_points(keyframe, candidate)
        if len(matches[0]) < thresholds.LOOP_MIN_MATCHES:
            return None
        table, factors = self._map.keyframes, self._map.scale_factors
        a, b = table.features[keyframe], table.features[candidate]
        pose_a, pose_b = table.camera_from_world[keyframe], table.camera_from_world[candidate]
        pairs = (
            self._in_camera(table.points[keyframe, matches[0]], pose_a),
            self._in_camera(table.points[candidate, matches[1]], pose_b),
            a.pixels[matches[0]],
            b.pixels[matches[1]],
            factors[a.octaves[matches[0]]] ** -2.0,
            factors[b.octaves[matches[1]]] ** -2.0,
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
        keyframe_from_world = sim3_compose(similarity, pose_b)
        points = self._project_loop_side(keyframe, candidate, keyframe_from_world)
        found = int((points >= 0).sum())
        if found < thresholds.LOOP_MIN_PROJECTED:
            return None
        return Loop(keyframe, candidate, keyframe_from_world, points, found)

    def _match_points(self, keyframe: int, candidate: int) -> tuple[Indices, Indices]:
        """Features of both keyframes that look alike and both show a map point, (N,) each."""
        table = self._map.keyframes
        a, b = table.features[keyframe], table.features[candidate]
        matches = match_by_appearance(
            a.descriptors, self._places.nodes(keyframe), table.points[keyframe, : len(a)] >= 0,
            b.descriptors, self._places.nodes(candidate), table.points[candidate, : len(b)] >= 0,
            thresholds.HAMMING_LOW, thresholds.LOOP_RATIO,
        )  # fmt: skip
        keep_consistent_rotations(matches, a.angles, b.angles)
        found = np.nonzero(matches >= 0)[0]
        return found, matches[found]

    def _in_camera(self, points: Indices, camera_from_world: Array) -> Array:
        return np.asarray(self._map.points.positions[points] @ camera_from_world[:3, :3].T + camera_from_world[:3, 3])

    def _project_loop_side(self, keyframe: int, candidate: int, keyframe_from_world: Array) -> Indices:
        """Points of the loop side by the feature of `keyframe` that shows them (N,), by projection."""
        features = self._map.keyframes.features[keyframe]
        group = np.concatenate([[candidate], self._map.neighbors(candidate)[0]])
        projections = project_map_points(
            self._map, self._map.points_of(group), rigid_part(keyframe_from_world), self._camera,
            thresholds.VIEWING_COSINE,
        )  # fmt: skip
        matches = match_in_windows(
            projections.pixels, thresholds.LOOP_WINDOW_PX * self._map.scale_factors[projections.octaves],
            projections.octaves - 1, projections.octaves + 1, self._map.points.descriptors[projections.points],
            features, np.ones(len(features), np.bool_), thresholds.HAMMING_LOW,
        )  # fmt: skip
        shown = np.full(len(features), NONE, np.int64)
        shown[matches[matches >= 0]] = projections.points[matches >= 0]
        return shown


def rigid_part(similarity: Array) -> Array:
    """The rigid motion (4, 4) that gives the same image as `similarity`, camera from world: [R, t / s]."""
    scale = sim3_scale(similarity)
    return np.asarray(sim3_from_parts(1.0, similarity[:3, :3] / scale, similarity[:3, 3] / scale))
