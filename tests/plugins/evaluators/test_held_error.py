"""No part of a real trajectory is better than the whole, by the error with positions held.

The trajectories in tests/golden/trajectories are of our SLAM on the first 200 frames of TUM's
freiburg3_long_office_household, tracked frames only, in metres; the truth is read from the folder of real sequences.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from project import ROOT

from codecbench.core.contracts.sequence import Trajectory
from codecbench.plugins.evaluators.trajectory import errors
from codecbench.plugins.evaluators.trajectory.alignment import align, associate, nearest_stamps

FRAMES = 200
KEPT = sorted((ROOT / "tests" / "golden" / "trajectories").glob("*.txt"))


class Run:
    """A stored run beside the truth: its frames' times, and what of it is tracked."""

    def __init__(self, path: Path, folder: Path) -> None:
        truth = positions(folder / "groundtruth.txt")
        lines = (folder / "rgb.txt").read_text().splitlines()
        stamps_s = np.array([float(line.split()[0]) for line in lines if not line.startswith("#")][:FRAMES])
        self.whole = positions(path)
        self.truth = truth
        nearest = nearest_stamps(stamps_s, truth.timestamps_s, 0.02)
        self.stamps_s = stamps_s[nearest >= 0]
        self.true_positions = truth.positions_world[nearest[nearest >= 0]]

    def held(self, kept: np.ndarray) -> float:
        """The error where only these tracked frames are known, by their positions."""
        part = Trajectory(self.whole.timestamps_s[kept], self.whole.world_from_camera[kept])
        return errors.held_errors(self.stamps_s, self.true_positions, part).whole_m


def positions(path: Path) -> Trajectory:
    """Times and positions of a file in TUM's format."""
    rows = np.loadtxt(path, ndmin=2)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, 3] = rows[:, 1:4]
    return Trajectory(rows[:, 0], poses)


@pytest.fixture(params=KEPT, ids=lambda path: path.stem)
def run(request: pytest.FixtureRequest, data_folder: Path) -> Run:
    return Run(request.param, data_folder / "fr3_office_715")


def improved(run: Run, cuts: dict[str, np.ndarray]) -> list[str]:
    whole = run.held(np.arange(len(run.whole)))
    return [f"{name}: {found:.5f} < {whole:.5f}" for name, kept in cuts.items() if (found := run.held(kept)) < whole]


def test_no_truncation_improves_it(run: Run) -> None:
    every = np.arange(len(run.whole))
    cuts = {f"first {count}": every[:count] for count in range(5, len(every))}
    cuts |= {f"last {count}": every[-count:] for count in range(5, len(every))}
    assert improved(run, cuts) == []


def test_no_thinning_improves_it(run: Run) -> None:
    every = np.arange(len(run.whole))
    cuts = {f"every {step} from {first}": every[first::step] for step in range(2, 21) for first in range(min(step, 5))}
    rng = np.random.default_rng(2)
    for share in (0.5, 0.8, 0.9, 0.95):
        for trial in range(20):
            cuts[f"{share} at random, {trial}"] = np.flatnonzero(rng.random(len(every)) < share)
    assert improved(run, cuts) == []


def test_no_restart_improves_it(run: Run) -> None:
    """A gap of any length anywhere, as between a loss and the next frame that is located."""
    every = np.arange(len(run.whole))
    cuts = {
        f"without {first} to {first + length}": np.delete(every, np.arange(first, first + length))
        for length in (5, 10, 20, 50)
        for first in range(1, len(every) - length - 1, 3)
    }
    assert improved(run, cuts) == []


def test_the_error_alone_is_improved_by_cutting(run: Run) -> None:
    """Which is why it ranks nothing."""

    def error(count: int) -> float:
        part = Trajectory(run.whole.timestamps_s[:count], run.whole.world_from_camera[:count])
        cut = associate(part, run.truth, 0.02)
        return errors.rms(errors.position_errors(cut, align(cut)))

    assert min(map(error, range(10, 60, 5))) < error(len(run.whole))
