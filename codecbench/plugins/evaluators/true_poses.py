"""Where the camera truly was at each frame, and how far two poses are apart."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.plugins.evaluators.trajectory.alignment import nearest_stamps

Poses = NDArray[np.float64]


def true_poses(sequence: FrameSequence, association_s: float) -> Poses:
    """(N, 4, 4) world_from_camera of every frame, NaN where no true pose is within `association_s` of it.

    Raises Unsupported where the sequence has no ground truth, or none near a frame.
    """
    truth = sequence.ground_truth
    if truth is None:
        raise Unsupported(f"sequence {sequence.name} has no ground truth; give one, or leave this evaluator out")
    nearest = nearest_stamps(sequence.timestamps_s, truth.timestamps_s, association_s)
    if not (nearest >= 0).any():
        raise Unsupported(f"no frame of {sequence.name} has a true pose within association_s = {association_s:g} s")
    poses = np.full((len(sequence), 4, 4), np.nan)
    poses[nearest >= 0] = truth.world_from_camera[nearest[nearest >= 0]]
    return poses


def rotation_angles_deg(rotations: NDArray[np.float64]) -> NDArray[np.float64]:
    """(...) angles in degrees, 0 to 180, of rotation matrices (..., 3, 3)."""
    # The sine and the cosine together: either alone loses small or large angles to rounding.
    skew = rotations - np.swapaxes(rotations, -1, -2)
    sine = 0.5 * np.sqrt(skew[..., 2, 1] ** 2 + skew[..., 0, 2] ** 2 + skew[..., 1, 0] ** 2)
    cosine = 0.5 * (np.trace(rotations, axis1=-2, axis2=-1) - 1.0)
    return np.asarray(np.degrees(np.arctan2(sine, cosine)))
