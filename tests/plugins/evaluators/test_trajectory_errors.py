"""Trajectory errors on paths with known answers, against closed forms and evo's own pipeline."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from synthetic_path import helix, moved, noisy, part

from codecbench.core.contracts.sequence import Trajectory
from codecbench.plugins.evaluators.trajectory import errors
from codecbench.plugins.evaluators.trajectory.alignment import (
    Pairs,
    Undefined,
    align,
    associate,
    nearest_stamps,
)


def umeyama(source: np.ndarray, target: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Umeyama 1991, eqs. 38-43, written out."""
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    covariance = (target - target_mean).T @ (source - source_mean) / len(source)
    left, singular, right = np.linalg.svd(covariance)
    signs = np.ones(3)
    if np.linalg.det(left) * np.linalg.det(right) < 0:
        signs[2] = -1.0
    rotation = left @ np.diag(signs) @ right
    scale = (singular * signs).sum() / ((source - source_mean) ** 2).sum(axis=1).mean()
    return scale, rotation, target_mean - scale * rotation @ source_mean


@given(
    scale=st.floats(0.01, 100.0),
    rotation=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    translation=st.tuples(*[st.floats(-50.0, 50.0)] * 3),
)
@settings(max_examples=50)
def test_alignment_recovers_a_known_similarity(
    scale: float, rotation: tuple[float, ...], translation: tuple[float, ...]
) -> None:
    truth = helix(40)
    turned = Rotation.from_rotvec(rotation).as_matrix()
    poses = truth.world_from_camera.copy()
    poses[:, :3, 3] = (truth.positions_world - translation) @ turned / scale
    found = align(Pairs(Trajectory(truth.timestamps_s, poses), truth))
    assert found.scale == pytest.approx(scale, rel=1e-9)
    np.testing.assert_allclose(found.rotation, turned, atol=1e-9)
    np.testing.assert_allclose(found.translation, translation, atol=1e-8)


def test_alignment_is_umeyama_written_out() -> None:
    truth = helix(60)
    pairs = Pairs(moved(noisy(truth, 0.05)), truth)
    scale, rotation, translation = umeyama(pairs.estimate.positions_world, truth.positions_world)
    found = align(pairs)
    assert found.scale == pytest.approx(scale, rel=1e-12)
    np.testing.assert_allclose(found.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(found.translation, translation, atol=1e-12)


def test_ate_is_that_of_evos_own_pipeline() -> None:
    """evo associates, aligns and measures by itself, from timestamps and poses."""
    from evo.core import metrics, sync
    from evo.core.trajectory import PoseTrajectory3D

    truth = helix(300, rate_hz=100.0)
    frames = part(truth, slice(0, 300, 7))
    estimate = moved(noisy(Trajectory(frames.timestamps_s + 0.003, frames.world_from_camera), 0.02))
    reference, other = sync.associate_trajectories(
        PoseTrajectory3D(poses_se3=list(truth.world_from_camera), timestamps=truth.timestamps_s),
        PoseTrajectory3D(poses_se3=list(estimate.world_from_camera), timestamps=estimate.timestamps_s),
        max_diff=0.02,
    )
    other.align(reference, correct_scale=True)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, other))
    pairs = associate(estimate, truth, 0.02)
    found = errors.position_errors(pairs, align(pairs))
    np.testing.assert_allclose(found, ape.error, atol=1e-9)
    assert errors.rms(found) == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), abs=1e-12)


def test_relative_errors_are_evos_where_there_are_no_gaps() -> None:
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    truth = helix(80, rate_hz=10.0)
    estimate = noisy(truth, 0.03)
    estimate.world_from_camera[:, :3, :3] = (
        estimate.world_from_camera[:, :3, :3] @ Rotation.from_rotvec(0.01 * np.eye(3)[np.arange(80) % 3]).as_matrix()
    )
    pairs = Pairs(moved(estimate), truth)
    similarity = align(pairs)
    found = errors.relative_errors(pairs, similarity, 1.0, 0.05)
    aligned = similarity.trajectory(pairs.estimate)
    both = [PoseTrajectory3D(poses_se3=list(t.world_from_camera), timestamps=t.timestamps_s) for t in (truth, aligned)]
    for relation, value in (
        (metrics.PoseRelation.translation_part, found.trans_m),
        (metrics.PoseRelation.rotation_angle_deg, found.rot_deg),
    ):
        rpe = metrics.RPE(relation, delta=10, delta_unit=metrics.Unit.frames, all_pairs=True)
        rpe.process_data(tuple(both))
        assert value == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)


def test_relative_errors_step_over_gaps() -> None:
    """With a gap, pairs stay one second apart: the drift per second is what it is without one."""
    truth = helix(200, rate_hz=10.0)
    poses = truth.world_from_camera.copy()
    poses[:, :3, 3] += 0.01 * truth.timestamps_s[:, None] * [1.0, 0.0, 0.0]
    drifting = Trajectory(truth.timestamps_s, poses)
    kept = np.r_[0:60, 130:200]
    identity = align(Pairs(truth, truth))
    whole = errors.relative_errors(Pairs(drifting, truth), identity, 1.0, 0.05)
    gappy = errors.relative_errors(Pairs(part(drifting, kept), part(truth, kept)), identity, 1.0, 0.05)
    assert whole.trans_m == pytest.approx(0.01, rel=1e-6)
    assert gappy.trans_m == pytest.approx(0.01, rel=1e-6)
    assert whole.rot_deg == pytest.approx(0.0, abs=1e-5)


def test_known_similarity_gives_zero_everywhere() -> None:
    truth = helix(90)
    pairs = Pairs(moved(truth), truth)
    similarity = align(pairs)
    assert errors.rms(errors.position_errors(pairs, similarity)) == pytest.approx(0.0, abs=1e-12)
    assert errors.first_frame_rmse(pairs) == pytest.approx(0.0, abs=1e-12)
    assert errors.scale_drift(pairs) == pytest.approx(0.0, abs=1e-12)
    assert max(errors.relative_errors(pairs, similarity, 1.0, 0.05)) == pytest.approx(0.0, abs=1e-5)


def test_known_noise_gives_its_own_size() -> None:
    truth = helix(2000, rate_hz=100.0)
    pairs = Pairs(moved(noisy(truth, 0.01)), truth)
    similarity = align(pairs)
    distances = errors.position_errors(pairs, similarity)
    assert errors.rms(distances) == pytest.approx(0.01 * math.sqrt(3), rel=0.03)
    assert np.median(distances) == pytest.approx(0.01 * 1.5382, rel=0.05)  # median of the Maxwell distribution
    assert errors.relative_errors(pairs, similarity, 1.0, 0.005).trans_m == pytest.approx(0.01 * math.sqrt(6), rel=0.05)
    assert errors.first_frame_rmse(pairs) > errors.rms(distances)


def test_first_frame_error_is_the_definition_written_out() -> None:
    truth = helix(50)
    estimate = moved(noisy(truth, 0.05))
    true, found = (
        np.array([(np.linalg.inv(t.world_from_camera[0]) @ pose)[:3, 3] for pose in t.world_from_camera])
        for t in (truth, estimate)
    )
    ratios = np.linalg.norm(true[1:], axis=1) / np.linalg.norm(found[1:], axis=1)
    expected = np.sqrt(np.mean(np.sum((np.median(ratios) * found - true) ** 2, axis=1)))
    assert errors.first_frame_rmse(Pairs(estimate, truth)) == pytest.approx(expected, rel=1e-12)


def test_first_frame_error_takes_the_first_rotation_as_it_is() -> None:
    """A first pose that is turned by 90 degrees ruins this error and leaves the aligned one alone."""
    truth = helix(50)
    poses = truth.world_from_camera.copy()
    poses[0, :3, :3] = poses[0, :3, :3] @ Rotation.from_euler("y", 90, degrees=True).as_matrix()
    pairs = Pairs(Trajectory(truth.timestamps_s, poses), truth)
    assert errors.first_frame_rmse(pairs) > 0.5
    assert errors.rms(errors.position_errors(pairs, align(pairs))) == pytest.approx(0.0, abs=1e-12)


def test_scale_drift_is_the_logarithm_of_the_change() -> None:
    """The last third is drawn 25 % larger."""
    truth = helix(90)
    poses = truth.world_from_camera.copy()
    poses[60:, :3, 3] *= 1.25
    estimate = Trajectory(truth.timestamps_s, poses)
    assert errors.scale_drift(Pairs(moved(estimate), truth)) == pytest.approx(math.log(1.25), rel=1e-9)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.7])
@pytest.mark.parametrize("sigma_m", [0.001, 0.05, 0.5])
def test_giving_up_costs_more_than_it_gains(share: float, sigma_m: float) -> None:
    """With positions held a trajectory cut short is worse than the whole one, though its plain error is better."""
    truth = helix(400)
    whole = moved(noisy(truth, sigma_m))
    cut = part(whole, slice(0, round(share * 400)))
    assert held(truth, cut).whole_m > held(truth, whole).whole_m


def held(truth: Trajectory, estimate: Trajectory) -> errors.HeldErrors:
    return errors.held_errors(truth.timestamps_s, truth.positions_world, estimate)


def ruler(count: int) -> Trajectory:
    """A camera that moves a metre a frame along a line."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = np.arange(float(count))
    return Trajectory(0.1 * np.arange(count), poses)


def test_held_error_in_closed_form() -> None:
    """On a line it is what a regression of 0 to 5 on 2, 2, 2, 3, 3, 3 leaves: 35/12 - 0.75^2 / 0.25."""
    truth = ruler(6)
    known = moved(part(truth, slice(2, 4)))
    assert held(truth, known).whole_m == pytest.approx(math.sqrt(2 / 3))
    assert held(truth, moved(truth)).whole_m == pytest.approx(0.0, abs=1e-6)


def test_parts_of_the_held_error_in_closed_form() -> None:
    """The same regression: 0 to 5 are off by 1, 0, 1, 1, 0 and 1, two frames each before, during and after."""
    truth = ruler(6)
    parts = held(truth, moved(part(truth, slice(2, 4))))
    np.testing.assert_allclose(parts, np.sqrt([1 / 6, 2 / 6, 1 / 6]), rtol=1e-12)


def test_a_helix_cut_at_both_ends_and_in_the_middle_has_parts_that_add_up() -> None:
    """By evo's alignment of the held poses, frame by frame."""
    truth = helix(100)
    known = np.r_[20:50, 60:80]
    parts = held(truth, moved(noisy(part(truth, known), 0.05)))
    of_frames = np.r_[np.full(20, 0), np.arange(30), np.full(10, 29), np.arange(30, 50), np.full(20, 49)]
    poses = noisy(part(truth, known), 0.05).world_from_camera[of_frames]
    pairs = Pairs(Trajectory(truth.timestamps_s, poses), truth)
    squares = errors.position_errors(pairs, align(pairs)) ** 2
    tracked = np.isin(np.arange(100), known)
    waiting = np.arange(100) < 20
    expected = [np.sqrt(squares[of].sum() / 100) for of in (waiting, tracked, ~tracked & ~waiting)]
    np.testing.assert_allclose(parts, expected, rtol=1e-9)
    assert parts.whole_m**2 == pytest.approx(squares.mean())


@pytest.mark.parametrize("known", [slice(0, 0), slice(3, 4)])
def test_where_no_motion_is_known_the_spread_is_left(known: slice) -> None:
    truth = ruler(6)
    found = held(truth, part(truth, known)).whole_m
    assert found == pytest.approx(math.sqrt(35 / 12))


@pytest.mark.parametrize("mirrored", [False, True])
def test_held_error_of_a_whole_trajectory_is_evo_s(mirrored: bool) -> None:
    """A mirror is no rotation, however well it would fit."""
    truth = helix(200)
    poses = noisy(truth, 0.3).world_from_camera
    poses[:, 0, 3] *= -1.0 if mirrored else 1.0
    estimate = Trajectory(truth.timestamps_s, poses)
    pairs = Pairs(estimate, truth)
    expected = errors.rms(errors.position_errors(pairs, align(pairs)))
    assert held(truth, estimate).whole_m == pytest.approx(expected, rel=1e-9)


def test_a_position_is_held_from_frames_without_ground_truth_too() -> None:
    """Of frames 0 to 4 the estimate has all but the last, the truth all but the one before."""
    truth, estimate = ruler(5), part(ruler(5), slice(0, 4))
    there = [0, 1, 2, 4]
    found = errors.held_errors(truth.timestamps_s[there], truth.positions_world[there], estimate).whole_m
    slope, offset = np.polyfit([0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 4.0], 1)
    left = np.array([0.0, 1.0, 2.0, 4.0]) - (slope * np.arange(4.0) + offset)
    assert found == pytest.approx(errors.rms(left))


@given(st.lists(st.floats(0, 10), max_size=20), st.lists(st.floats(0, 10), max_size=20), st.floats(0.0, 2.0))
@settings(deadline=None)
def test_nearest_stamps_are_the_nearest(first: list[float], second: list[float], tolerance_s: float) -> None:
    stamps, others = np.unique(first), np.unique(second)
    found = nearest_stamps(stamps, others, tolerance_s)
    for stamp, at in zip(stamps, found, strict=True):
        gaps = np.abs(others - stamp)
        if at < 0:
            assert len(others) == 0 or gaps.min() > tolerance_s
        else:
            assert gaps[at] == gaps.min()
            assert gaps[at] <= tolerance_s + 1e-6


@pytest.mark.parametrize("count", [0, 1, 2])
def test_too_few_poses_are_undefined_with_their_number(count: int) -> None:
    truth = helix(50)
    pairs = associate(part(truth, slice(0, count)), truth, 0.02)
    for compute in (align, errors.first_frame_rmse, errors.scale_drift):
        with pytest.raises(Undefined, match=f"^{count} tracked"):
            compute(pairs)


def test_a_straight_path_has_the_error_that_is_least_for_every_turn_about_it(rng: np.random.Generator) -> None:
    """By hand: after the best scale along the line, what is left is along it and across it."""
    stamps_s = np.arange(40.0)
    poses = np.tile(np.eye(4), (40, 1, 1))
    poses[:, 0, 3] = stamps_s
    truth = Trajectory(stamps_s, poses)
    turn = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    for noise in (0.0, 0.1):
        offsets = noise * rng.standard_normal((40, 3))
        found = poses.copy()
        found[:, :3, 3] = 0.25 * (poses[:, :3, 3] + offsets) @ turn.T + [4.0, 5.0, 6.0]
        pairs = Pairs(Trajectory(stamps_s, found), truth)
        estimated, true = (p.positions_world - p.positions_world.mean(axis=0) for p in (pairs.estimate, truth))
        power, product = np.mean(np.sum(estimated**2, axis=1)), np.linalg.norm(true.T @ estimated / 40)
        least = np.sqrt(max(0.0, np.mean(np.sum(true**2, axis=1)) - product**2 / power))
        assert errors.rms(errors.position_errors(pairs, align(pairs))) == pytest.approx(least, abs=1e-6)
        with pytest.raises(Undefined, match="on one line"):
            align(pairs, whole_turn=True)


def test_a_trajectory_that_stands_still_is_undefined() -> None:
    truth = helix(50)
    still = Trajectory(truth.timestamps_s, np.tile(np.eye(4), (50, 1, 1)))
    pairs = Pairs(still, truth)
    with pytest.raises(Undefined, match="undetermined"):
        align(pairs)
    with pytest.raises(Undefined, match="never leaves"):
        errors.first_frame_rmse(pairs)
    with pytest.raises(Undefined, match="does not move"):
        errors.scale_drift(pairs)
