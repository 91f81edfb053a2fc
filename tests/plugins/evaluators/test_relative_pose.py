"""Relative poses: two-view geometry with known answers, pairs by known motion, and a filmed room."""

from __future__ import annotations

import math
import re
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from memory_sequence import CodedInMemory, FunctionCodec, MemorySequence, context, jpeg, textured
from rendered_scenes import CAMERA as VIEW
from rendered_scenes import Room, looking, two_views
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera, Trajectory
from codecbench.plugins.evaluators.relative_pose import RelativePose
from codecbench.plugins.evaluators.relative_pose.matching import NO_KEYPOINTS, KeypointSet, Matcher
from codecbench.plugins.evaluators.relative_pose.pairs import Pair, overlap, pair_of, scene_distance_m
from codecbench.plugins.evaluators.relative_pose.two_view import (
    WORST_ERROR_DEG,
    TwoViewMotion,
    curve_area,
    estimate_motion,
    near_epipolar_lines,
    pose_error_deg,
)
from codecbench.plugins.evaluators.trajectory.alignment import true_poses

CAMERA = Camera(VIEW.width, VIEW.height, VIEW.fx, VIEW.fy, VIEW.cx, VIEW.cy)
FRAMES = 14


@cache
def film(yaw: float) -> tuple[tuple[Image, ...], np.ndarray]:
    """A camera that slides to its right through a room, a tenth of a unit a frame, and turns a little.

    It looks at a wall 4 units away, or at `yaw` 0.8 into a corner, which leaves no doubt how it moved: a plane does.
    """
    room, right = Room(), np.array([np.cos(yaw), 0.0, -np.sin(yaw)])
    places = [(0.1 * step - 0.7) * right for step in range(FRAMES)]
    poses = [looking(tuple(place), yaw + 0.01 * step) for step, place in enumerate(places)]
    return tuple(room.image(pose) for pose in poses), np.linalg.inv(poses)


def sequence(truth: bool = True, camera: Camera | None = CAMERA, yaw: float = 0.8) -> MemorySequence:
    images, poses = film(yaw)
    return MemorySequence(list(images), camera, Trajectory(np.arange(FRAMES) / 10.0, poses) if truth else None)


def measured(folder: Path, codec: FunctionCodec | None = None, **params: object) -> list[Measurement]:
    params = {"baselines": (0.05, 0.1), **params}
    return list(RelativePose.create(**params).evaluate(CodedInMemory(sequence(), codec), context(folder)))


def values(found: list[Measurement], metric: str) -> np.ndarray:
    return np.array([m.value for m in found if m.metric == metric])


# Two views ----------------------------------------------------------------------------------------------------------


def test_the_motion_between_two_views_is_found_exactly(rng: np.random.Generator) -> None:
    views = two_views(rng)
    found = estimate_motion(views.pixels_a, views.pixels_b, VIEW.matrix, 1.0)
    assert found is not None
    assert found.inliers == len(views.points)
    assert pose_error_deg(found, views.b_from_a) < 0.01
    direction = views.b_from_a[:3, 3] / np.linalg.norm(views.b_from_a[:3, 3])
    np.testing.assert_allclose(found.translation, direction, atol=1e-3)  # points are ahead of both cameras


def test_wrong_matches_are_left_out(rng: np.random.Generator) -> None:
    views = two_views(rng, noise_px=0.3)
    pixels = views.pixels_b.copy()
    pixels[:120] = rng.permutation(pixels[:120])
    found = estimate_motion(views.pixels_a, pixels, VIEW.matrix, 1.0)
    assert found is not None
    assert 170 <= found.inliers < 230
    assert pose_error_deg(found, views.b_from_a) < 3.0


def test_where_nothing_is_to_be_found_the_error_is_the_largest() -> None:
    assert estimate_motion(np.zeros((4, 2)), np.zeros((4, 2)), VIEW.matrix, 1.0) is None
    assert pose_error_deg(None, np.eye(4)) == WORST_ERROR_DEG == 180.0


@pytest.mark.parametrize(("turn_deg", "slant_deg"), [(3.0, 1.0), (1.0, 7.0), (0.0, 0.0), (0.0, 90.0)])
def test_the_error_is_the_larger_of_two_angles(turn_deg: float, slant_deg: float) -> None:
    true = np.eye(4)
    true[:3, :3] = Rotation.from_rotvec([0.2, -0.1, 0.3]).as_matrix()
    true[:3, 3] = [0.0, 0.0, 2.0]
    slant = np.radians(slant_deg)
    turned = Rotation.from_rotvec(np.radians(turn_deg) * np.array([0.6, 0.0, 0.8])).as_matrix() @ true[:3, :3]
    for sign in (1.0, -1.0):  # a direction and its opposite count as one
        found = TwoViewMotion(turned, sign * np.array([np.sin(slant), 0.0, np.cos(slant)]), 50)
        assert pose_error_deg(found, true) == pytest.approx(max(turn_deg, slant_deg), abs=1e-6)


def test_the_mean_share_of_pairs_is_the_area_under_their_curve(rng: np.random.Generator) -> None:
    """Against the trapezoids by which the matching literature integrates, which differ by a pair's share at most."""
    errors = rng.gamma(1.5, 4.0, 400)
    for threshold in (5.0, 10.0, 20.0):
        ordered = np.r_[0.0, np.sort(errors)]
        shares = np.arange(401) / 400
        last = int(np.searchsorted(ordered, threshold))
        theirs = np.trapezoid(np.r_[shares[:last], shares[last - 1]], np.r_[ordered[:last], threshold]) / threshold
        assert np.mean([curve_area(error, threshold) for error in errors]) == pytest.approx(theirs, abs=1 / 400)
    assert [curve_area(error, 10.0) for error in (0.0, 2.5, 10.0, 180.0)] == [1.0, 0.75, 0.0, 0.0]


def test_matches_obey_the_motion_they_were_made_with_and_no_other(rng: np.random.Generator) -> None:
    views = two_views(rng)
    near = near_epipolar_lines(views.pixels_a, views.pixels_b, VIEW.matrix, views.b_from_a, 1e-6)
    assert near.all()
    moved = views.pixels_b + np.array([0.0, 5.0])
    assert near_epipolar_lines(views.pixels_a, moved, VIEW.matrix, views.b_from_a, 2.0).mean() < 0.1


# Matches ------------------------------------------------------------------------------------------------------------


def matcher(detector: str = "orb", ratio: float = 0.8, camera: Camera = CAMERA) -> Matcher:
    return Matcher(detector, 300, ratio, camera)  # type: ignore[arg-type]


def test_binary_matches_are_mutual_and_clear(rng: np.random.Generator) -> None:
    first = rng.integers(0, 256, (60, 32), dtype=np.uint8)
    second = np.concatenate([first[20:] ^ np.uint8(1), rng.integers(0, 256, (9, 32), dtype=np.uint8), first[30:35]])
    bits = np.unpackbits(first[:, None] ^ second[None], axis=2).sum(axis=2)
    best, runner_up = np.sort(bits, axis=1)[:, :2].T
    expected = [
        [i, j]
        for i, j in enumerate(bits.argmin(axis=1).tolist())
        if bits[:, j].argmin() == i and best[i] < 0.8 * runner_up[i]
    ]
    sets = [KeypointSet(np.zeros((len(d), 2)), np.ascontiguousarray(d).view(np.uint64)) for d in (first, second)]
    found = matcher().match(*sets)
    assert found.tolist() == expected
    assert len(found) >= 40
    assert len(matcher(ratio=0.01).match(*sets)) == 5  # those copied to the last bit


def test_vector_matches_are_those_of_opencv(rng: np.random.Generator) -> None:
    first, second = (rng.normal(size=(count, 128)).astype(np.float32) for count in (50, 70))
    second[10:50] = first[10:] + rng.normal(0, 0.5, (40, 128)).astype(np.float32)
    brute = cv2.BFMatcher(cv2.NORM_L2)
    back = {m.queryIdx: m.trainIdx for (m,) in brute.knnMatch(second, first, 1)}
    expected = [
        [m.queryIdx, m.trainIdx]
        for m, n in brute.knnMatch(first, second, 2)
        if m.distance < 0.8 * n.distance and back[m.trainIdx] == m.queryIdx
    ]
    sets = [KeypointSet(np.zeros((len(d), 2)), d) for d in (first, second)]
    assert matcher("sift").match(*sets).tolist() == expected


@pytest.mark.parametrize("detector", ["orb", "sift"])
def test_an_image_matches_itself(detector: str) -> None:
    keypoints = matcher(detector).detect(textured(240, 320))
    matches = matcher(detector).match(keypoints, keypoints)
    assert len(matches) > 100
    assert (matches[:, 0] == matches[:, 1]).all()


@pytest.mark.parametrize("image", [np.full((240, 320), 90, np.uint8), np.zeros((5, 5), np.uint8)])
def test_an_image_with_nothing_in_it_matches_nothing(image: Image) -> None:
    nothing = matcher().detect(image)
    assert nothing is NO_KEYPOINTS
    assert len(matcher().match(nothing, matcher().detect(textured(240, 320)))) == 0


def test_keypoints_are_undistorted() -> None:
    bent = Camera(320, 240, 260.0, 262.0, 158.5, 121.0, (-0.2, 0.05, 0.0, 0.0, 0.0))
    image = textured(240, 320)
    straight, found = matcher().detect(image), matcher(camera=bent).detect(image)
    expected = cv2.undistortPoints(
        straight.pixels[:, None], VIEW.matrix, np.array(bent.distortion), P=VIEW.matrix
    )[:, 0]  # fmt: skip
    np.testing.assert_allclose(found.pixels, expected)
    assert np.abs(found.pixels - straight.pixels).max() > 3.0


def test_keypoints_of_a_fisheye_are_undistorted() -> None:
    fisheye = Camera(320, 240, 90.0, 90.0, 158.5, 121.0, (0.02, -0.01, 0.003, 0.0, 0.0), "equidistant")
    image = textured(240, 320)
    plain, found = matcher().detect(image), matcher(camera=fisheye).detect(image)
    matrix, k = np.array([[90.0, 0.0, 158.5], [0.0, 90.0, 121.0], [0.0, 0.0, 1.0]]), np.array(fisheye.distortion[:4])
    expected = cv2.fisheye.undistortPoints(plain.pixels[:, None], matrix, k, P=matrix)[:, 0]
    seen = (
        np.hypot(*((plain.pixels - [158.5, 121.0]) / 90.0).T) < np.radians(75.0) * 1.05
    )  # not beyond what the lens sees
    seen &= np.hypot(*(expected - [158.5, 121.0]).T) < 90.0 * np.tan(np.radians(75.0))
    assert 0.5 < seen.mean() < 1.0
    np.testing.assert_allclose(found.pixels, expected[seen], atol=1e-3)
    assert len(found.descriptors) == seen.sum()


# Pairs --------------------------------------------------------------------------------------------------------------


def test_the_distance_of_the_scene_is_that_of_the_wall() -> None:
    wall = sequence(yaw=0.0)
    assert scene_distance_m(wall, true_poses(wall, 0.02), matcher()) == pytest.approx(4.0, rel=0.2)


def test_a_pair_is_the_first_frame_far_enough_away() -> None:
    poses = true_poses(sequence(), 0.02)
    pair = pair_of(2, poses, CAMERA, 4.0, 0.06, 0.5)  # 0.24 units: the third frame after
    assert isinstance(pair, Pair)
    assert (pair.first, pair.second) == (2, 5)
    np.testing.assert_allclose(pair.second_from_first, np.linalg.inv(poses[5]) @ poses[2], atol=1e-12)
    assert re.findall(r"[\d.]+", str(pair_of(FRAMES - 2, poses, CAMERA, 4.0, 0.06, 0.5))) == ["0.06", "0.24"]
    assert "shows only" in str(pair_of(0, poses, CAMERA, 4.0, 0.25, 0.99))
    poses[[3, 5]] = np.nan
    assert "no true pose" in str(pair_of(3, poses, CAMERA, 4.0, 0.06, 0.5))
    passed_over = pair_of(2, poses, CAMERA, 4.0, 0.06, 0.5)
    assert isinstance(passed_over, Pair)
    assert passed_over.second == 6


def test_overlap_of_a_fisheye_counts_what_lies_in_its_picture() -> None:
    fisheye = Camera(320, 240, 120.0, 120.0, 159.5, 119.5, (0.0,) * 5, "equidistant")
    turned = np.eye(4)
    turned[:3, :3] = cv2.Rodrigues(np.array([0.0, np.radians(40.0), 0.0]))[0]
    pinhole = Camera(320, 240, 120.0, 120.0, 159.5, 119.5)
    assert overlap(np.eye(4), fisheye, 3.0) == 1.0
    assert overlap(turned, fisheye, 3.0) > overlap(turned, pinhole, 3.0) + 0.05


def test_overlap_is_the_share_that_both_see() -> None:
    motion = np.eye(4)
    assert overlap(motion, CAMERA, 3.0) == 1.0
    motion[0, 3] = 0.5 * CAMERA.width / CAMERA.fx * 3.0  # half an image to the side, at that distance
    assert overlap(motion, CAMERA, 3.0) == pytest.approx(0.5, abs=0.05)
    motion[:3, :3] = Rotation.from_rotvec([0.0, np.pi, 0.0]).as_matrix()
    assert overlap(motion, CAMERA, 3.0) == 0.0


# The evaluator ------------------------------------------------------------------------------------------------------


def test_raw_frames_lose_nothing_and_find_their_motion(tmp_path: Path) -> None:
    found = measured(tmp_path)
    assert {m.metric for m in found} == {metric.name for metric in RelativePose.metrics}
    assert {m.frame for m in found} == set(range(FRAMES))
    errors = values(found, "pose_error_deg")
    assert len(errors) == FRAMES
    assert np.isfinite(errors).sum() >= FRAMES - 5
    assert np.nanmedian(errors) < 5.0
    lost = values(found, "matches_lost")
    assert (lost[np.isfinite(lost)] == 0.0).all()
    assert np.nanmin(values(found, "correct_matches")) > 30


def test_frames_without_a_pair_say_why(tmp_path: Path) -> None:
    missing = {m.frame: m.reason for m in measured(tmp_path) if math.isnan(m.value)}
    assert FRAMES - 1 in missing
    assert all("scene distances" in str(reason) for reason in missing.values())


@pytest.mark.thorough
def test_worse_pictures_lose_matches(tmp_path: Path) -> None:
    kept = [
        np.nanmean(values(measured(tmp_path, FunctionCodec(lambda i, q=q: jpeg(i, q))), "correct_matches"))
        for q in (90, 20, 3)
    ]
    assert kept[0] > kept[1] > kept[2]
    lost = measured(tmp_path, FunctionCodec(lambda image: jpeg(image, 3)))
    assert np.nanmean(values(lost, "matches_lost")) > 0.3


def test_pictures_with_nothing_in_them_solve_nothing(tmp_path: Path) -> None:
    found = measured(tmp_path, FunctionCodec(np.zeros_like))
    errors = values(found, "pose_error_deg")
    assert (errors[np.isfinite(errors)] == 180.0).all()
    assert np.nanmax(values(found, "pose_auc_20deg")) == 0.0
    assert np.nanmin(values(found, "matches_lost")) == 1.0


@pytest.mark.parametrize("detector", ["orb", pytest.param("sift", marks=pytest.mark.thorough)])
def test_equal_frames_give_equal_values_whatever_was_drawn_before(detector: str, tmp_path: Path) -> None:
    runs = []
    for seed in (1, 99):
        cv2.setRNGSeed(seed)
        found = measured(tmp_path, FunctionCodec(lambda image: jpeg(image, 15)), detector=detector)
        runs.append([(m.metric, m.frame, m.value) for m in found if not math.isnan(m.value)])
    assert runs[0] == runs[1]


def test_a_sequence_without_truth_camera_or_motion_is_unsupported(tmp_path: Path) -> None:
    evaluator = RelativePose.create()
    for lacking, words in ((sequence(truth=False), "no ground truth"), (sequence(camera=None), "no camera")):
        with pytest.raises(Unsupported, match=words):
            list(evaluator.evaluate(CodedInMemory(lacking), context(tmp_path)))
    resting = sequence()
    resting.ground_truth = Trajectory(resting.timestamps_s, np.tile(np.eye(4), (FRAMES, 1, 1)))
    with pytest.raises(Unsupported, match="must move"):
        list(evaluator.evaluate(CodedInMemory(resting), context(tmp_path)))
    with pytest.raises(Unsupported, match="see baselines"):
        list(RelativePose.create(baselines=[1.5]).evaluate(CodedInMemory(sequence()), context(tmp_path)))
