"""Extending and refining the map around a new keyframe (ORB-SLAM VI), in step with tracking."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds
from codecbench.slam.features.extractor import Features
from codecbench.slam.features.matching import match_in_windows
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.fusion import fuse
from codecbench.slam.map.map import NONE, Indices, Map
from codecbench.slam.map.point_kernels import median_depth
from codecbench.slam.map.triangulation import triangulate_features
from codecbench.slam.optimization.bundle_adjustment import HUBER_95, adjust
from codecbench.slam.places.recognition import PlaceRecognition


class Mapper:
    """Inserts keyframes into one map."""

    def __init__(self, slam_map: Map, camera: Camera) -> None:
        self.map = slam_map
        self.camera = camera
        self.places = PlaceRecognition(slam_map)
        self._probation: Indices = np.empty(0, np.int64)

    def insert(self, frame: TrackingFrame) -> int:
        """Make `frame`, whose pose and points are known, a keyframe; returns its index.

        Culls points on probation, triangulates new ones and fuses duplicates; `refine_neighborhood` does the rest. The
        map then has the keyframe's changed pose and points, `frame` not yet.
        """
        keyframe = self.add(frame)
        self._cull_points()
        neighbors, _ = self.map.neighbors(keyframe, thresholds.TRIANGULATION_NEIGHBORS)
        self._triangulate(keyframe, neighbors)
        self._fuse_neighborhood(keyframe, neighbors)
        return keyframe

    def refine_neighborhood(self, keyframe: int) -> None:
        """Adjust the surroundings of the keyframe inserted last, and cull redundant keyframes there."""
        self.adjust_locally(keyframe)
        self._cull_keyframes(keyframe)

    def add(self, frame: TrackingFrame) -> int:
        """Add `frame` to the map with the points that it shows, and nothing more; returns its index."""
        slam_map = self.map
        keyframe = slam_map.keyframes.add(frame.features, frame.camera_from_world, frame.index, frame.timestamp_s)
        frame.points = slam_map.resolve_points(frame.points)
        _clear_repeated(frame.points)
        matched = frame.matched_features
        slam_map.observe(keyframe, matched, frame.points[matched])
        slam_map.refresh_points(frame.points[matched])
        slam_map.attach(keyframe)
        self.places.add(keyframe, frame.features)
        frame.reference = keyframe
        return keyframe

    def append(self, other: Mapper, order: Indices) -> tuple[Indices, int]:
        """Take over another mapper's map with its place recognition and points on probation; see Map.append."""
        numbers, first_point = self.map.append(other.map, order)
        self.places.append(other.places, numbers)
        self._probation = np.concatenate([self._probation, other._probation + first_point])
        return numbers, first_point

    def add_points(
        self, keyframe: int, features: Indices, others: int | Indices, other_features: Indices, points: Array
    ) -> None:
        """Add points (N, 3), seen at `features` (N,) of a keyframe and `other_features` (N,) of `others` (N,)."""
        slam_map = self.map
        added = slam_map.points.add(points, keyframe, slam_map.keyframes.count)
        slam_map.observe(keyframe, features, added)
        slam_map.observe(others, other_features, added)
        slam_map.refresh_points(added)
        self._probation = np.concatenate([self._probation, added])

    # Points ---------------------------------------------------------------------------------------------------

    def _cull_points(self) -> None:
        """Remove points that are seldom found, or that too few keyframes see after a trial (ORB-SLAM VI-B)."""
        table = self.map.points
        young = self._probation[table.alive[self._probation]]
        ages = self.map.keyframes.count - table.born[young]
        seldom = table.found_counts[young] < thresholds.POINT_MIN_FOUND_SHARE * table.visible_counts[young]
        unseen = table.observation_counts[young] < thresholds.POINT_MIN_OBSERVATIONS
        dying = seldom | ((ages >= thresholds.POINT_TRIAL_KEYFRAMES) & unseen)
        self.map.remove_points(young[dying])
        self._probation = young[~dying & (ages < thresholds.POINT_PROBATION_KEYFRAMES)]

    def _triangulate(self, keyframe: int, neighbors: Indices) -> None:
        """Triangulate free features of a keyframe that match free features of its neighbors (ORB-SLAM VI-C)."""
        triangulated = triangulate_features(
            keyframe, neighbors, self.map.keyframes.views, self.map.points.positions,
            self.camera.matrix, self.map.scale_factors, self.map.pixel_variances,
        )  # fmt: skip
        self.add_points(keyframe, *triangulated)

    def median_depth(self, keyframe: int) -> float:
        """Return the median depth of the points that `keyframe` sees; 1 if it sees none."""
        slam_map = self.map
        pose = slam_map.keyframes.camera_from_world[keyframe]
        return float(median_depth(slam_map.keyframes.points[keyframe], slam_map.points.positions, pose))

    # Duplicates -----------------------------------------------------------------------------------------------

    def _fuse_neighborhood(self, keyframe: int, neighbors: Indices) -> None:
        """Search the keyframe's points in its neighbors and theirs in it; fuse duplicates (ORB-SLAM VI-C)."""
        targets = list(dict.fromkeys(int(n) for n in neighbors))
        for neighbor in neighbors[:5]:
            for second in self.map.neighbors(int(neighbor), 5)[0]:
                if second != keyframe and int(second) not in targets:
                    targets.append(int(second))
        poses, points = self.map.keyframes.camera_from_world, self.map.keyframes.points[keyframe]
        counts_before = self.map.points.observation_counts.copy()
        for target in targets:
            fuse(self.map, self.camera, target, points[points >= 0], poses[target])
        fuse(self.map, self.camera, keyframe, self.map.points_of(np.array(targets, dtype=np.int64)), poses[keyframe])
        points = points[points >= 0]
        self.map.refresh_points(points[self.map.points.observation_counts[points] != counts_before[points]])

    # Adjustment -----------------------------------------------------------------------------------------------

    def adjust_locally(self, keyframe: int) -> None:
        """Adjust a keyframe, its neighbors and their points; other keyframes that see them are held fixed."""
        neighbors, _ = self.map.neighbors(keyframe, thresholds.LOCAL_BUNDLE_KEYFRAMES - 1)
        free = np.concatenate([[keyframe], neighbors])
        points = self.map.points_of(free)
        weights = self.map.covisibility(points)
        weights[free] = 0
        order = np.argsort(-weights, kind="stable")
        fixed = order[weights[order] > 0][: thresholds.LOCAL_BUNDLE_FIXED]
        if len(fixed) == 0:  # the oldest keeps its pose; only damping holds the scale
            fixed, free = free[free == free.min()], free[free != free.min()]
        adjust_keyframes(self.map, self.camera, free, fixed, points, (5,), thresholds.LOCAL_BUNDLE_TOLERANCE)

    def _cull_keyframes(self, keyframe: int) -> None:
        """Remove neighbors nearly all of whose points three others see at least as finely (ORB-SLAM VI-E)."""
        for neighbor in self.map.neighbors(keyframe)[0]:
            if neighbor > 0 and self.map.is_redundant(int(neighbor)):
                self.map.remove_keyframe(int(neighbor))
                self.places.remove(int(neighbor))


def _clear_repeated(points: Indices) -> None:
    """Set all but the first of repeated points to NONE, in place."""
    order = np.argsort(points, kind="stable")
    repeated = order[1:][points[order[1:]] == points[order[:-1]]]
    points[repeated] = NONE


def adjust_keyframes(
    slam_map: Map,
    camera: Camera,
    free: Indices,
    fixed: Indices,
    points: Indices,
    iterations: tuple[int, ...],
    tolerance: float = 1e-4,
    huber: float = HUBER_95,
) -> None:
    """Adjust `free` keyframes and `points`, with `fixed` keyframes; outliers lose their observation."""
    table, keyframes = slam_map.points, slam_map.keyframes
    chosen = np.concatenate([free, fixed]).astype(np.int64)
    slots = np.full(keyframes.count, NONE, np.int64)
    slots[chosen] = np.arange(len(chosen))
    point_rows, seen_by, features = slam_map.observations(points, chosen)
    seen = seen_by * keyframes.points.shape[1] + features  # flat rows by feature: one index is faster than two
    result = adjust(
        keyframes.camera_from_world[chosen], table.positions[points], slots[seen_by], point_rows,
        keyframes.pixels.reshape(-1, 2).take(seen, axis=0),
        slam_map.inverse_sigma2[keyframes.octaves.ravel().take(seen)], camera.intrinsics,
        np.arange(len(chosen)) >= len(free), iterations=iterations, tolerance=tolerance, huber=huber,
    )  # fmt: skip
    keyframes.set_pose(free, result.camera_from_world[: len(free)])
    table.positions[points] = result.points_world
    slam_map.unobserve(seen_by[~result.inliers], features[~result.inliers])
    slam_map.refresh_points(points[table.alive[points]], False)


def match_decoded_features(
    raw: Features, decoded: Features, chosen: NDArray[np.int64], scale_factors: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Match features `chosen` (N,) of a raw image with those of the decoded image; returns (N,), -1 for none.

    The match is the nearest in appearance within a small window.
    """
    octaves = raw.octaves[chosen].astype(np.int64)
    return match_in_windows(
        raw.pixels[chosen], thresholds.DECODED_WINDOW_PX * scale_factors[octaves], octaves - 1, octaves + 1,
        raw.descriptors[chosen], decoded, np.ones(len(decoded), np.bool_), thresholds.HAMMING_LOW,
    )  # fmt: skip


def use_decoded_features(frame: TrackingFrame, scale_factors: NDArray[np.float64]) -> None:
    """Replace the features of `frame` by those of its decoded image, if it has one, and carry its points over."""
    if frame.decode is None:
        return
    raw, frame.features, frame.decode = frame.features, frame.decode(), None
    matched = frame.matched_features
    matches = match_decoded_features(raw, frame.features, matched, scale_factors)
    points = np.full(len(frame.features), NONE, np.int64)
    points[matches[matches >= 0]] = frame.points[matched[matches >= 0]]
    frame.points = points
