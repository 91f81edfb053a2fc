"""Align two trajectories: in time by nearest stamps, in space by the best similarity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.sequence import FrameSequence, Trajectory

MIN_POSES: Final = 3
"""The fewest poses that determine a similarity."""


class Undefined(Exception):
    """A quantity has no value for this trajectory. The message is the reason that the table shows."""


@dataclass(frozen=True)
class Pairs:
    """Poses of an estimate and of a reference at the same times, one to one and in order of time."""

    estimate: Trajectory
    reference: Trajectory

    def __len__(self) -> int:
        return len(self.estimate)


@dataclass(frozen=True)
class Similarity:
    """The map x -> scale * rotation @ x + translation, reference_from_estimate."""

    scale: float
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]

    def points(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points (N, 3) of the estimate in the reference's coordinates and unit."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)

    def trajectory(self, trajectory: Trajectory) -> Trajectory:
        """The estimate's poses in the reference's coordinates and unit; they stay rigid."""
        poses = trajectory.world_from_camera.copy()
        poses[:, :3, :3] = self.rotation @ poses[:, :3, :3]
        poses[:, :3, 3] = self.points(trajectory.positions_world)
        return Trajectory(trajectory.timestamps_s, poses)


def nearest_stamps(
    stamps_s: NDArray[np.float64], others_s: NDArray[np.float64], tolerance_s: float
) -> NDArray[np.int64]:
    """(N,) for each stamp the index of the nearest other, or -1 if none is within `tolerance_s`.

    Both are increasing; the earlier wins among equals.
    """
    if len(others_s) == 0:
        return np.full(len(stamps_s), -1, dtype=np.int64)
    after = np.clip(np.searchsorted(others_s, stamps_s), 1, max(len(others_s) - 1, 1))
    after = np.minimum(after, len(others_s) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(stamps_s - others_s[before] <= others_s[after] - stamps_s, before, after)
    # Stamps are seconds since 1970 to the microsecond: a double holds them to 0.2 microseconds.
    near = np.abs(others_s[nearest] - stamps_s) <= tolerance_s + 1e-6
    return np.where(near, nearest, -1).astype(np.int64)


def associate(estimate: Trajectory, reference: Trajectory, tolerance_s: float) -> Pairs:
    """Pair each pose of the estimate with the reference's nearest in time, if one is within `tolerance_s`."""
    nearest = nearest_stamps(estimate.timestamps_s, reference.timestamps_s, tolerance_s)
    is_paired = nearest >= 0
    return Pairs(_select(estimate, np.flatnonzero(is_paired)), _select(reference, nearest[is_paired]))


def align(pairs: Pairs, whole_turn: bool = False) -> Similarity:
    """The similarity that minimises the squared distances between paired positions.

    Umeyama, "Least-squares estimation of transformation parameters between two point patterns", IEEE TPAMI 13(4),
    1991, doi:10.1109/34.88573, as evo computes it. On a straight line the rotation about it is undetermined; the result
    is one of the best, which all give the same distances. Raises Undefined for fewer than MIN_POSES pairs and if all
    positions are one; with whole_turn also for straight lines.
    """
    from evo.core.geometry import GeometryException, umeyama_alignment  # GPL: imported only when used

    if len(pairs) < MIN_POSES:
        raise Undefined(f"{len(pairs)} tracked frame(s) have ground truth; a similarity needs {MIN_POSES}")
    try:
        rotation, translation, scale = umeyama_alignment(
            pairs.estimate.positions_world.T, pairs.reference.positions_world.T, True
        )
    except GeometryException as error:
        estimated, true = pairs.estimate.positions_world, pairs.reference.positions_world
        if whole_turn or min(np.ptp(estimated, axis=0).max(), np.ptp(true, axis=0).max()) == 0.0:
            raise Undefined("the tracked positions are on one line or equal; the similarity is undetermined") from error
        return align_any_turn(estimated, true)
    return Similarity(float(scale), rotation, translation)


def align_any_turn(estimated: NDArray[np.float64], true: NDArray[np.float64]) -> Similarity:
    """One of the best similarities of positions (N, 3), by Umeyama's eqs. 40 to 42.

    These hold also if several are best. Estimates that are all one are moved to the mean of the true positions.
    """
    from_mean, to_mean = estimated.mean(axis=0), true.mean(axis=0)
    left, strengths, right = np.linalg.svd((true - to_mean).T @ (estimated - from_mean) / len(true))
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(left) * np.linalg.det(right))])
    power = float(np.mean(np.sum((estimated - from_mean) ** 2, axis=1)))
    scale = float(strengths @ signs) / power if power > 0.0 else 0.0
    rotation = (left * signs) @ right
    return Similarity(scale, rotation, to_mean - scale * rotation @ from_mean)


def _select(trajectory: Trajectory, positions: NDArray[np.int64]) -> Trajectory:
    return Trajectory(trajectory.timestamps_s[positions], trajectory.world_from_camera[positions])


Poses = NDArray[np.float64]


def true_poses(sequence: FrameSequence, association_s: float) -> Poses:
    """(N, 4, 4) world_from_camera of every frame, NaN if no true pose is within `association_s` of it.

    Raises Unsupported if the sequence has no ground truth, none near a frame, or one without rotations.
    """
    truth = sequence.ground_truth
    if truth is None:
        raise Unsupported(f"sequence {sequence.name} has no ground truth; give one, or leave this evaluator out")
    if not truth.has_rotations:
        raise Unsupported(f"the ground truth of {sequence.name} has positions only; leave this evaluator out")
    nearest = nearest_stamps(sequence.timestamps_s, truth.timestamps_s, association_s)
    if not (nearest >= 0).any():
        raise Unsupported(f"no frame of {sequence.name} has a true pose within association_s = {association_s:g} s")
    poses = np.full((len(sequence), 4, 4), np.nan)
    poses[nearest >= 0] = truth.world_from_camera[nearest[nearest >= 0]]
    return poses


def rotation_angles_deg(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) angles in degrees, 0 to 180, of rotation matrices (..., 3, 3)."""
    # Sine and cosine are used together because either alone is inaccurate for small or for large angles.
    skew = rotations - np.swapaxes(rotations, -1, -2)
    sine = 0.5 * np.sqrt(skew[..., 2, 1] ** 2 + skew[..., 0, 2] ** 2 + skew[..., 1, 0] ** 2)
    cosine = 0.5 * (np.trace(rotations, axis1=-2, axis2=-1) - 1.0)
    return np.asarray(np.degrees(np.arctan2(sine, cosine)))
