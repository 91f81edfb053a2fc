"""A trajectory cell's files, drawn: paths in the plane of the true path, cropped to the frames that were given."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codecbench.core.contracts.evaluator import Measurement, Outcome
from codecbench.core.contracts.sequence import Trajectory
from codecbench.core.contracts.slam import TrackedFrame
from codecbench.plugins.evaluators.trajectory import TrajectoryEvaluator, files

STAMPS_S = np.arange(100) / 10.0


def path(stamps_s: np.ndarray) -> Trajectory:
    """A circle of 2 m radius in a plane that is tilted by 0.3 rad about x."""
    poses = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    angles = stamps_s * 2 * np.pi / 10.0
    flat = np.column_stack([2 * np.cos(angles), 2 * np.sin(angles)])
    poses[:, :3, 3] = flat @ np.array([[1, 0, 0], [0, np.cos(0.3), np.sin(0.3)]])
    return Trajectory(stamps_s, poses)


def outcome(folder: Path, **values: float) -> Outcome:
    return Outcome(0, tuple(Measurement(name, value) for name, value in values.items()), folder)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Frames 20 to 69 were given, of which the last 40 were tracked; the truth covers all 100."""
    given = [TrackedFrame(index, STAMPS_S[index], "tracked" if index >= 30 else "lost") for index in range(20, 70)]
    files.write_states(tmp_path / files.STATES, tuple(given))
    files.write_tum(tmp_path / files.GROUND_TRUTH, path(STAMPS_S))
    files.write_tum(tmp_path / files.TRAJECTORY, path(STAMPS_S[30:70]))
    files.write_tum(tmp_path / files.TRAJECTORY_BEFORE_LOOPS, path(STAMPS_S[30:70]))
    return tmp_path


def drawn(cell: Outcome):  # type: ignore[no-untyped-def]
    return TrajectoryEvaluator.create().drawing(cell)


def test_the_circle_is_seen_from_above_and_paths_lie_on_it(folder: Path) -> None:
    drawing = drawn(outcome(folder, ate_rmse_m=0.0123, tracked_fraction=0.8, success=1.0, loops_closed=2.0))
    lines = {line.stroke: line.points for line in drawing.lines}
    assert [line.name for line in drawing.lines] == ["ground truth", "estimated", "optimised"]
    steps = np.linalg.norm(np.diff(lines["after"], axis=0), axis=1)
    assert steps == pytest.approx(2 * 2 * np.sin(np.pi / 100), abs=1e-4)  # chords of the circle in its own plane
    assert np.allclose(lines["after"], lines["before"])
    assert drawing.caption == "ATE 0.0123 m, 80 % tracked, 2 loops"
    assert drawing.holds is True


def test_the_truth_is_shown_for_the_frames_that_were_given_and_half_a_second_around(folder: Path) -> None:
    drawing = drawn(outcome(folder))
    lines = {line.stroke: line.points for line in drawing.lines}
    assert len(lines["truth"]) == 50 + 5 + 5
    assert np.allclose(lines["truth"][5 + 10 : -5], lines["after"], atol=1e-6)


def test_the_timeline_says_of_each_frame_where_it_is_and_how_far_off(folder: Path) -> None:
    """The path is 0.1 m beside the truth from frame 40 on; frames 20 to 29 were lost."""
    shifted = path(STAMPS_S[30:70])
    shifted.world_from_camera[10:, 0, 3] += 0.1
    files.write_tum(folder / files.TRAJECTORY, shifted)
    timeline = drawn(outcome(folder)).timeline
    assert timeline.frames.tolist() == list(range(20, 70))
    assert np.isnan(timeline.positions[:10]).all()
    assert not np.isnan(timeline.positions[10:]).any()
    assert np.isnan(timeline.errors[:10]).all()
    assert timeline.errors[10:20] == pytest.approx(0.0, abs=1e-6)
    assert timeline.errors[20:] == pytest.approx(0.1, abs=1e-6)
    assert timeline.unit == "m"
    (folder / files.GROUND_TRUTH).unlink()
    assert np.isnan(drawn(outcome(folder)).timeline.errors).all(), "no true path, no error"
    (folder / files.STATES).unlink()
    assert drawn(outcome(folder)).timeline is None


def test_an_unknown_result_is_no_failure(folder: Path) -> None:
    failed = drawn(outcome(folder, ate_rmse_m=1.0, tracked_fraction=0.5, success=0.0))
    assert failed.holds is False
    assert failed.caption.endswith("fails")
    unknown = drawn(outcome(folder, tracked_fraction=0.5))
    assert unknown.holds is None
    assert unknown.caption == "error unknown, 50 % tracked"


def test_a_frame_is_on_the_lane_of_what_slam_made_of_it(folder: Path) -> None:
    rows = {row.name: (row.tone, np.flatnonzero(row.holds)) for row in drawn(outcome(folder)).timeline.rows}
    assert {name: (tone, len(holds)) for name, (tone, holds) in rows.items()} == {
        "tracked": ("good", 40), "track lost": ("bad", 10)
    }  # fmt: skip
    assert rows["track lost"][1].tolist() == list(range(10))


def test_where_nothing_was_tracked_the_true_path_and_the_timeline_are_left(folder: Path) -> None:
    files.write_tum(folder / files.TRAJECTORY, path(STAMPS_S[:0]))
    files.write_tum(folder / files.TRAJECTORY_BEFORE_LOOPS, path(STAMPS_S[:0]))
    drawing = drawn(outcome(folder))
    assert [line.stroke for line in drawing.lines] == ["truth"]
    assert np.isnan(drawing.timeline.errors).all()
    assert [row.name for row in drawing.timeline.rows] == ["tracked", "track lost"]


def test_nothing_tracked_and_no_truth_is_nothing_drawn(folder: Path, tmp_path: Path) -> None:
    (folder / files.GROUND_TRUTH).unlink()
    assert [line.stroke for line in drawn(outcome(folder)).lines] == ["before", "after"]
    files.write_tum(folder / files.TRAJECTORY, path(STAMPS_S[:0]))
    assert drawn(outcome(folder)) is None
