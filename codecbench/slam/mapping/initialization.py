"""Initialization: the first map, from two frames of unknown motion (ORB-SLAM IV)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam import thresholds
from codecbench.slam.features.extractor import Features, pixel_variances
from codecbench.slam.features.matching import keep_consistent_rotations, match_in_windows
from codecbench.slam.geometry import two_view as geometry
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.linear_systems import copy_numbers
from codecbench.slam.geometry.two_view import direction_deviation_deg
from codecbench.slam.geometry.two_view_points import TwoViewPoints
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import Map
from codecbench.slam.mapping.mapper import Mapper, adjust_keyframes, match_decoded_features, use_decoded_features

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TwoViewReconstruction:
    """A motion and points that two frames agree on."""

    second_from_first: Floats
    """Motion (4, 4) of unit translation."""
    points_first: Floats
    """Points (N, 3) in the frame of the first camera."""
    features_first: NDArray[np.int64]
    """Features (N,) of the first frame that show the points."""
    features_second: NDArray[np.int64]
    """Features (N,) of the second frame that show the points."""
    model: str
    """"homography" or "fundamental"."""


def match_for_initialization(first: Features, second: Features, camera: Camera) -> NDArray[np.int64]:
    """Match features (N,) of `first` with `second` in a window and on one level; returns (N,), -1 for none."""
    octaves = first.octaves.astype(np.int64)
    radii = np.full(len(first), camera.pixels_across(thresholds.INIT_WINDOW_DEG))
    matches = match_in_windows(
        first.pixels, radii, octaves, octaves, first.descriptors,
        second, np.ones(len(second), np.bool_), thresholds.HAMMING_LOW, thresholds.INIT_RATIO,
    )  # fmt: skip
    return np.asarray(keep_consistent_rotations(matches, first.angles, second.angles))


def reconstruct_two_views(
    first: Features,
    second: Features,
    matches: NDArray[np.int64],
    level_variances: Floats,
    camera: Camera,
    rng: np.random.Generator,
) -> TwoViewReconstruction | str:
    """Return motion and points from `matches` (N,) of `first` with `second`, or the reason why there are none.

    `level_variances` (L,) are those of a feature's position on each level, px^2. Homography and fundamental matrix are
    fitted side by side; S_H / (S_H + S_F) chooses (ORB-SLAM IV, equation 4). A motion is accepted if no mere rotation
    explains the matches as well, if it alone puts most points in front of both cameras with enough parallax, and if the
    matches leave little doubt about its direction.
    """
    features_first = np.nonzero(matches >= 0)[0]
    features_second = matches[features_first]
    pixels_a, pixels_b = first.pixels[features_first], second.pixels[features_second]
    if len(features_first) < thresholds.INIT_MIN_MATCHES:
        return f"{len(features_first)} matches between the first two frames"
    variances = level_variances[first.octaves[features_first]]
    samples = rng.integers(
        0, len(pixels_a), (thresholds.INIT_RANSAC_ITERATIONS, 8)
    )  # a sample with a repeat just loses
    homography, inliers_h, score_h, fundamental, inliers_f, score_f = _fit_models(
        pixels_a, pixels_b, variances, samples
    )
    if score_h + score_f <= 0.0:
        return "neither a homography nor a fundamental matrix fits"
    planar = score_h / (score_h + score_f) > thresholds.INIT_HOMOGRAPHY_SHARE
    inliers = inliers_h if planar else inliers_f
    rotation_inliers = _count_rotation_inliers(homography, pixels_a, pixels_b, variances, camera)
    if rotation_inliers > thresholds.INIT_ROTATION_SHARE * inliers.sum():
        return f"a rotation explains {rotation_inliers} matches, a motion {inliers.sum()}"
    if planar:
        motions = geometry.decompose_homography(homography, camera.matrix)
    else:
        motions = geometry.decompose_fundamental(fundamental, camera.matrix)
    chosen = _choose_motion(motions, pixels_a, pixels_b, variances, int(inliers.sum()), camera)
    if isinstance(chosen, str):
        return chosen
    motion, points, good = chosen
    deviation = direction_deviation_deg(motion, pixels_a[good], pixels_b[good], variances[good], camera.matrix)
    if deviation > thresholds.INIT_MAX_DEVIATION_DEG:
        return f"the direction of motion is uncertain by {deviation:.1f} degrees"
    selected = np.nonzero(good)[0]
    return TwoViewReconstruction(
        motion,
        points[good],
        features_first[selected],
        features_second[selected],
        "homography" if planar else "fundamental",
    )


@compiled
def _fit_models(pixels_a: Any, pixels_b: Any, variances: Any, samples: Any) -> Any:
    """Return the best homography and fundamental matrix of samples (S, 8), each refitted to its inliers."""
    normalized_a, normalizer_a = geometry.normalize_pixels(pixels_a)
    normalized_b, normalizer_b = geometry.normalize_pixels(pixels_b)
    undo_b = np.linalg.inv(normalizer_b)
    n = len(pixels_a)
    homography, fundamental = np.eye(3), np.zeros((3, 3))
    inliers_h, inliers_f = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    trial = np.zeros(n, np.bool_)
    score_h, score_f = 0.0, 0.0
    for s in range(len(samples) + 2):
        if s < len(samples):
            chosen_h, chosen_f = samples[s, :4], samples[s]
        else:  # the last two rounds refine
            chosen_h, chosen_f = np.nonzero(inliers_h)[0], np.nonzero(inliers_f)[0]
        if len(chosen_h) >= 4:
            fitted = geometry.fit_homography(normalized_a[chosen_h], normalized_b[chosen_h])
            fitted = undo_b @ fitted @ normalizer_a
            score = geometry.score_homography(fitted, pixels_a, pixels_b, variances, trial)
            if score > score_h:
                homography, score_h = fitted, score
                copy_numbers(trial, inliers_h)
        if len(chosen_f) >= 8:
            fitted = geometry.fit_fundamental(normalized_a[chosen_f], normalized_b[chosen_f])
            fitted = normalizer_b.T @ fitted @ normalizer_a
            score = geometry.score_fundamental(fitted, pixels_a, pixels_b, variances, trial)
            if score > score_f:
                fundamental, score_f = fitted, score
                copy_numbers(trial, inliers_f)
    return homography, inliers_h, score_h, fundamental, inliers_f, score_f


def _count_rotation_inliers(
    homography: Floats, pixels_a: Floats, pixels_b: Floats, variances: Floats, camera: Camera
) -> int:
    """Return how many matches a camera that only turns explains, by the rotation nearest to a homography.

    The rotation is fitted to its inliers. Without translation there is no depth; a plane or a fundamental matrix then
    fits only the noise.
    """
    to_rays = np.linalg.inv(camera.matrix)
    rays_a, rays_b = camera.rays(pixels_a), camera.rays(pixels_b)
    u, _, vt = np.linalg.svd(to_rays @ homography @ camera.matrix)
    rotation = u @ vt * np.sign(np.linalg.det(u @ vt))
    inliers, most = np.zeros(len(pixels_a), np.bool_), 0
    for _ in range(5):
        turn = camera.matrix @ rotation @ to_rays
        geometry.score_homography(turn, pixels_a, pixels_b, variances, inliers)
        if inliers.sum() <= max(most, 2):
            break
        most = int(inliers.sum())
        rotation = geometry.fit_rotation(rays_a[inliers], rays_b[inliers])
    return most


def _choose_motion(
    motions: list[Floats], pixels_a: Floats, pixels_b: Floats, variances: Floats, inlier_count: int, camera: Camera
) -> tuple[Floats, Floats, NDArray[np.bool_]] | str:
    """Return the one motion that most points agree with, its points (N, 3) and which of them are good (N,).

    All matches count, not the model's inliers alone: points off a plane distinguish its two motions. Returns the reason
    if no motion is clearly best.
    """
    results, limits = [], thresholds.CHI2_95_2DOF * variances
    for motion in motions:
        views = TwoViewPoints(np.eye(4), motion, pixels_a, pixels_b, camera.intrinsics)
        agree = (views.depths_a > 0.0) & (views.depths_b > 0.0)
        agree &= (views.errors_a < limits) & (views.errors_b < limits)
        results.append((int(agree.sum()), motion, views, agree))
    results.sort(key=lambda result: -result[0])
    count, motion, views, agree = results[0]
    if count < max(thresholds.INIT_MIN_POINTS, thresholds.INIT_WINNER_SHARE * inlier_count):
        return f"the best motion agrees with {count} points, the model with {inlier_count}"
    for rival_count, rival, _, rival_agree in results[1:]:
        apart = int((agree != rival_agree).sum())  # matches that distinguish the two; winner's less rival's:
        if count - rival_count < thresholds.INIT_RIVAL_SIGMAS * np.sqrt(apart) and not _nearly_equal(rival, motion):
            return f"two motions agree with {count} and {rival_count} points"
    angles = np.degrees(np.arccos(np.clip(views.cosines[agree], -1.0, 1.0)))
    parallax = float(np.sort(angles)[-min(thresholds.INIT_PARALLAX_RANK, count)])
    if parallax < thresholds.INIT_MIN_PARALLAX_DEG:
        return f"parallax of {parallax:.2f} degrees"
    return motion, views.points, agree & (views.cosines < thresholds.INIT_MAX_COSINE)


def _nearly_equal(motion_a: Floats, motion_b: Floats) -> bool:
    """Return whether two motions of unit translation mean the same start; bundle adjustment removes the rest."""
    limit = np.cos(np.radians(thresholds.INIT_SAME_MOTION_DEG))
    turn = (np.trace(motion_a[:3, :3].T @ motion_b[:3, :3]) - 1.0) / 2.0
    return bool(turn > limit and motion_a[:3, 3] @ motion_b[:3, 3] > limit)


class Initializer:
    """Waits for two frames from which a map can be started."""

    def __init__(self, camera: Camera, scale_factors: Floats, features_limit: int, rng: np.random.Generator) -> None:
        self._camera = camera
        self._scale_factors = scale_factors
        self._variances = pixel_variances(camera, scale_factors)
        self._features_limit = features_limit
        self._rng = rng
        self._first: TrackingFrame | None = None

    def restart(self) -> None:
        """Forget the reference frame."""
        self._first = None

    def add(self, frame: TrackingFrame, map_index: int) -> tuple[Map, Mapper] | str:
        """Try to start map number `map_index` from the reference frame and `frame`.

        Returns the map and its mapper, or the reason why there is none yet. On success both frames are in the map, as
        keyframes 0 and 1, and the median depth in the first is 1.
        """
        enough = len(frame.features) >= thresholds.INIT_MIN_FEATURES
        first = self._first
        if first is None or frame.index - first.index > thresholds.INIT_MAX_FRAMES:
            self._first = frame if enough else None
            return "waiting for a second view" if enough else f"{len(frame.features)} features"
        matches = match_for_initialization(first.features, frame.features, self._camera)
        if not enough or int((matches >= 0).sum()) < thresholds.INIT_MIN_MATCHES:
            self._first = frame if enough else None
            return f"{int((matches >= 0).sum())} matches between the first two frames"
        start = reconstruct_two_views(first.features, frame.features, matches, self._variances, self._camera, self._rng)
        if isinstance(start, str):
            return start
        if first.decode is not None or frame.decode is not None:
            start = self._transfer_to_decoded(first, frame, start)
            if len(start.points_first) < thresholds.INIT_MIN_POINTS:
                return f"{len(start.points_first)} points found again in the decoded images"
        outcome = self._build(first, frame, start, map_index)
        if not isinstance(outcome, str):
            self._first = None
        return outcome

    def _transfer_to_decoded(
        self, first: TrackingFrame, second: TrackingFrame, start: TwoViewReconstruction
    ) -> TwoViewReconstruction:
        """Return the same reconstruction on the features of the two decoded images."""
        matches = []
        for frame, features in ((first, start.features_first), (second, start.features_second)):
            raw = frame.features
            if frame.decode is None:
                matches.append(features)
                continue
            use_decoded_features(frame, self._scale_factors)
            matches.append(match_decoded_features(raw, frame.features, features, self._scale_factors))
        common = (matches[0] >= 0) & (matches[1] >= 0)
        return replace(
            start,
            points_first=start.points_first[common],
            features_first=matches[0][common],
            features_second=matches[1][common],
        )

    def _build(
        self, first: TrackingFrame, second: TrackingFrame, start: TwoViewReconstruction, index: int
    ) -> tuple[Map, Mapper] | str:
        """Build a map from two views: bundle adjustment over both, then the scale."""
        slam_map = Map(index, self._scale_factors, self._variances, self._features_limit)
        mapper = Mapper(slam_map, self._camera)
        second.camera_from_world = start.second_from_first
        first.camera_from_world = np.eye(4)
        mapper.add(first)
        mapper.add(second)
        mapper.add_points(1, start.features_second, 0, start.features_first, start.points_first)
        points = slam_map.alive_points
        adjust_keyframes(slam_map, self._camera, np.array([1]), np.array([0]), points, (20, 20))
        points = slam_map.alive_points
        depth = mapper.median_depth(0)
        if depth <= 0.0 or len(points) < thresholds.INIT_MIN_POINTS:
            return f"{len(points)} points left after bundle adjustment"
        slam_map.rescale(1.0 / depth)
        return slam_map, mapper
