"""Triangulation of a new keyframe's free features, matched on epipolar lines in its neighbors (ORB-SLAM VI-C).

One compiled call does all neighbors. Nothing here checks an index.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam import thresholds
from codecbench.slam.features.hamming import hamming
from codecbench.slam.features.matching import claim
from codecbench.slam.features.sorting import stable_order
from codecbench.slam.geometry.two_view import fundamental_between
from codecbench.slam.geometry.two_view_points import triangulate_pair
from codecbench.slam.map.point_kernels import median_depth
from codecbench.slam.map.tables import Views
from codecbench.slam.optimization.bundle_kernels import reprojection


@compiled
def triangulate_features(
    keyframe: int, neighbors: Any, views: Views, positions: Any, camera_matrix: Any, scale_factors: Any, variances: Any
) -> Any:
    """Triangulate points that free features of `keyframe` and of its `neighbors` show, first come first served.

    `positions` (P, 3) are those of the map's points; `scale_factors` and `variances` (px^2, of a keypoint's position)
    are those of the levels (L,). Returns for each new point its feature in `keyframe` (N,), the neighbor (N,), the
    feature there (N,), and its position in the world (N, 3).
    """
    count = views.counts[keyframe]
    free = views.points[keyframe, :count] < 0
    features, partners, partner_features = np.empty((3, count), np.int64)
    points, system, point_count = np.empty((count, 3)), np.empty((4, 4)), 0
    for neighbor in neighbors:
        depth = median_depth(views.points[neighbor], positions, views.poses[neighbor])
        if _distance(views.centers[keyframe], views.centers[neighbor]) < thresholds.TRIANGULATION_MIN_BASELINE * depth:
            continue
        matches = _match_on_lines(keyframe, neighbor, free, views, camera_matrix, scale_factors, variances)
        for f in range(count):
            other = matches[f]
            if other >= 0 and _triangulate_match(
                keyframe,
                f,
                neighbor,
                other,
                views,
                camera_matrix,
                scale_factors,
                variances,
                system,
                points[point_count],
            ):
                features[point_count], partners[point_count], partner_features[point_count] = f, neighbor, other
                free[f] = False
                point_count += 1
    return features[:point_count], partners[:point_count], partner_features[:point_count], points[:point_count]


@compiled
def _distance(a: Any, b: Any) -> float:
    return math.sqrt((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2)


@compiled
def _match_on_lines(
    keyframe: int, neighbor: int, free: Any, views: Views, camera_matrix: Any, scale_factors: Any, variances: Any
) -> Any:
    """Match free features of a keyframe with a neighbor's near their epipolar lines; returns (F,), -1 for none.

    A feature of the neighbor goes to the one that is nearest in Hamming distance, the first of equals.
    """
    fundamental, epipole = fundamental_between(views.poses[keyframe], views.poses[neighbor], camera_matrix)
    candidates, starts = _candidates(neighbor, epipole, views, scale_factors)
    count = len(candidates)  # three arrays: columns of one are not contiguous, and would not become vector code
    xs, ys, reaches = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    for k, f in enumerate(candidates):
        xs[k], ys[k] = views.pixels[neighbor, f, 0], views.pixels[neighbor, f, 1]
        reaches[k] = math.sqrt(thresholds.CHI2_95_1DOF * variances[views.octaves[neighbor, f]])
    pixels, octaves, descriptors = views.pixels[keyframe], views.octaves[keyframe], views.descriptors[keyframe]
    descriptors_b = views.descriptors[neighbor]
    eights = np.zeros(len(candidates) // 8 + 1, np.uint64)
    near, hits = eights.view(np.uint8), np.empty(len(candidates) + 8, np.int64)
    matches = np.full(len(free), -1, np.int64)
    owners = np.full(views.counts[neighbor], -1, np.int64)
    distances = np.full(views.counts[neighbor], thresholds.HAMMING_LOW + 1, np.int64)
    for f in range(len(free)):
        if not free[f]:
            continue
        first = starts[max(octaves[f] - thresholds.TRIANGULATION_OCTAVES_APART, 0)]
        last = starts[min(octaves[f] + thresholds.TRIANGULATION_OCTAVES_APART + 1, len(starts) - 1)]
        _mark_near_line(fundamental, pixels[f, 0], pixels[f, 1], xs, ys, reaches, first, last, near)
        count = _list_marked(eights, near, last - first, hits)
        best, best_distance = -1, thresholds.HAMMING_LOW + 1
        for k in range(count):
            other = candidates[first + hits[k]]
            distance = hamming(descriptors, f, descriptors_b, other)
            if distance < best_distance:
                best, best_distance = other, distance
        if best >= 0:
            claim(f, best, best_distance, matches, owners, distances)
    return matches


@compiled
def _mark_near_line(
    b_from_a: Any, x: float, y: float, xs: Any, ys: Any, reaches: Any, first: int, last: int, near: Any
) -> None:
    """Mark which positions, `first` to `last`, are within their reach of the epipolar line of a pixel."""
    a = b_from_a[0, 0] * x + b_from_a[0, 1] * y + b_from_a[0, 2]
    b = b_from_a[1, 0] * x + b_from_a[1, 1] * y + b_from_a[1, 2]
    c = b_from_a[2, 0] * x + b_from_a[2, 1] * y + b_from_a[2, 2]
    scale = 1.0 / max(math.sqrt(a * a + b * b), 1e-300)
    p, q, r = np.float32(a * scale), np.float32(b * scale), np.float32(c * scale)
    start = np.uint64(first)
    for k in range(np.uint64(last - first)):
        near[k] = abs(p * xs[start + k] + q * ys[start + k] + r) <= reaches[start + k]


@compiled
def _list_marked(eights: Any, marks: Any, length: int, out: Any) -> int:
    """Write the indices of the nonzero among the first `length` marks to `out`; returns their number.

    `eights` holds the same marks eight at a time, because most lines pass by most features. No branch depends on one
    mark.
    """
    marks[length : length + 8] = 0
    count = 0
    for word in range((length + 7) // 8):
        if eights[word] != 0:
            for k in range(8 * word, 8 * word + 8):
                out[count] = k
                count += marks[k]
    return count


@compiled
def _candidates(neighbor: int, epipole: Any, views: Views, scale_factors: Any) -> Any:
    """Return the free features of a keyframe (N,), level by level, and where each level begins (levels + 1,).

    Features too near to the epipole are left out: their depth is undetermined.
    """
    count = views.counts[neighbor]
    octaves = views.octaves[neighbor]
    candidates, levels, candidate_count = np.empty(count, np.int64), np.empty(count, np.int64), 0
    starts = np.zeros(len(scale_factors) + 1, np.int64)
    for f in range(count):
        nearest = thresholds.EPIPOLE_RADIUS_PX**2 * scale_factors[octaves[f]]
        dx, dy = views.pixels[neighbor, f, 0] - epipole[0], views.pixels[neighbor, f, 1] - epipole[1]
        if views.points[neighbor, f] < 0 and dx * dx + dy * dy >= nearest:
            candidates[candidate_count], levels[candidate_count] = f, octaves[f]
            starts[octaves[f] + 1] += 1
            candidate_count += 1
    for octave in range(len(scale_factors)):
        starts[octave + 1] += starts[octave]
    return candidates[stable_order(levels[:candidate_count], len(scale_factors))], starts


@compiled
def _triangulate_match(
    a: int, feature_a: int, b: int, feature_b: int, views: Views, camera_matrix: Any, scale_factors: Any,
    variances: Any, system: Any, point: Any,
) -> bool:  # fmt: skip
    """Fill in the `point` (3,) that features of keyframes a and b show; returns whether it passes every check.

    It must lie in front of both, within chi-square 5.991 of both features, far enough from parallel rays, and at
    distances whose ratio agrees with the features' scales. `system` (4, 4) is overwritten.
    """
    pixel_a, pixel_b = views.pixels[a, feature_a], views.pixels[b, feature_b]
    pose_a, pose_b = views.poses[a], views.poses[b]
    fx, fy, cx, cy = camera_matrix[0, 0], camera_matrix[1, 1], camera_matrix[0, 2], camera_matrix[1, 2]
    intrinsics = (fx, fy, cx, cy)
    x, y, z, w = triangulate_pair(pose_a, pose_b, pixel_a, pixel_b, intrinsics, system)
    if w == 0.0:
        return False
    point[0], point[1], point[2] = x / w, y / w, z / w
    octave_a, octave_b = views.octaves[a, feature_a], views.octaves[b, feature_b]
    for pose, pixel, octave in ((pose_a, pixel_a, octave_a), (pose_b, pixel_b, octave_b)):
        weight = 1.0 / math.sqrt(variances[octave])
        if reprojection(pose, point, pixel[0], pixel[1], weight, intrinsics)[5] > thresholds.CHI2_95_2DOF:
            return False
    center_a, center_b = views.centers[a], views.centers[b]
    distance_a, distance_b = _distance(point, center_a), _distance(point, center_b)
    dot = 0.0
    for k in range(3):
        dot += (point[k] - center_a[k]) * (point[k] - center_b[k])
    cosine = dot / max(distance_a * distance_b, 1e-24)
    stretch = distance_b * scale_factors[octave_a] / max(distance_a * scale_factors[octave_b], 1e-12)
    limit = thresholds.SCALE_CONSISTENCY * scale_factors[min(1, len(scale_factors) - 1)]
    return bool(0.0 < cosine < thresholds.TRIANGULATION_MAX_COSINE and 1.0 / limit < stretch < limit)
