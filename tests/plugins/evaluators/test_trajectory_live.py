"""SLAM at the end of a link: what it is given, and how far the robot's newest pose is from where it is."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memory_sequence import CodedInMemory, MemorySequence, Plugins, context
from pydantic import ValidationError
from synthetic_path import CAMERA, Told, helix, moved, part

from codecbench.core.contracts.evaluator import Measurement, Outcome
from codecbench.core.contracts.sequence import Trajectory
from codecbench.core.engine.planning.description import without_defaults
from codecbench.plugins.evaluators.trajectory import TrajectoryEvaluator
from codecbench.plugins.links.constant import Constant, Ideal

COUNT = 60


def measured(
    backend: Told, folder: Path, truth: Trajectory | None = None, repeat: int = 0, inputs: Any = None, **params: Any
) -> dict[str, Measurement]:
    """SLAM over frames of 48 bytes, ten a second."""
    images = [np.full((6, 8), index, np.uint8) for index in range(COUNT)]
    coded = CodedInMemory(MemorySequence(images, CAMERA, truth))
    plugins = Plugins(
        told=lambda _: backend,
        ideal=lambda given: Ideal.create(**given),
        constant=lambda given: Constant.create(**given),
    )
    evaluator = TrajectoryEvaluator.create(backend="told", **params)
    where = replace(context(folder, repeat, plugins), inputs=inputs or {})
    return {m.metric: m for m in evaluator.evaluate(coded, where)}


def constant(**params: Any) -> dict[str, Any]:
    return {"link": "constant", "link_params": {"rate_kbps": 1e6, **params}}


def rms(distances: Any) -> float:
    return float(np.sqrt(np.mean(np.square(distances))))


def test_an_ideal_link_changes_nothing(tmp_path: Path) -> None:
    truth = helix(COUNT)
    given = part(moved(truth), np.arange(5, COUNT))
    before, after = (measured(Told(given), tmp_path, truth, **params) for params in ({}, {"link": "ideal"}))
    for metric, measurement in before.items():
        if metric not in ("sent_size_bytes", "sent_rate_kbps"):  # over a link, headers count
            assert after[metric] == measurement or math.isnan(measurement.value), metric
    assert after["delivered_fraction"].value == 1.0
    assert after["sent_size_bytes"].value == before["sent_size_bytes"].value + 40 * COUNT


def test_an_old_pose_is_as_wrong_as_the_robot_has_moved(tmp_path: Path) -> None:
    """Each pose is known 250 ms after its frame: three frames later. Nothing is known at the first three."""
    truth = helix(COUNT)
    found = measured(Told(moved(truth)), tmp_path, truth, **constant(delay_ms=200), slam_ms=50)
    path = truth.positions_world
    by_hand = np.linalg.norm(path[3:] - path[:-3], axis=1)
    assert found["live_position_error_m"].value == pytest.approx(rms(by_hand))
    assert found["live_error_max_m"].value == pytest.approx(by_hand.max())
    assert found["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)
    assert found["first_pose_s"].value == pytest.approx(0.3)
    assert found["fresh_pose_fraction"].value == 57 / 60
    seen = path[3:]
    assert found["idle_error_m"].value == pytest.approx(rms(np.linalg.norm(seen - seen.mean(axis=0), axis=1)))


def test_a_pose_is_fresh_for_half_a_second(tmp_path: Path) -> None:
    """Poses of the first ten frames alone: those count until frame 14, which is half a second after frame 9."""
    truth = helix(COUNT)
    found = measured(Told(part(moved(truth), np.arange(10))), tmp_path, truth, link="ideal")
    assert found["fresh_pose_fraction"].value == 15 / 60
    assert found["live_position_error_m"].value > found["idle_error_m"].value


def test_without_delay_the_live_error_is_that_of_tracking(tmp_path: Path) -> None:
    truth = helix(COUNT)
    found = measured(Told(moved(truth)), tmp_path, truth, link="ideal")
    assert found["live_position_error_m"].value == pytest.approx(0.0, abs=1e-9)


def test_where_nothing_comes_the_error_is_the_spread_of_the_path(tmp_path: Path) -> None:
    truth = helix(COUNT)
    found = measured(Told(moved(truth)), tmp_path, truth, **constant(delay_ms=200), deadline_ms=100)
    spread = rms(np.linalg.norm(truth.positions_world - truth.positions_world.mean(axis=0), axis=1))
    assert found["delivered_fraction"].value == 0.0
    assert found["tracked_fraction"].value == 0.0
    assert found["live_position_error_m"].value == pytest.approx(spread)
    assert found["idle_error_m"].value == found["live_position_error_m"].value
    assert found["fresh_pose_fraction"].value == 0.0
    assert found["held_ate_m"].value == pytest.approx(spread)
    assert found["first_pose_s"].reason == "no pose was ever known"


def test_slam_sees_what_is_delivered_and_shares_are_of_all_frames(tmp_path: Path) -> None:
    truth = helix(COUNT)
    backend = Told(moved(truth))
    found = measured(backend, tmp_path, truth, **constant(loss=0.4))
    seen = [frame.index for frame in backend.seen]
    assert 0.4 < len(seen) / COUNT < 0.8
    assert found["delivered_fraction"].value == len(seen) / COUNT
    assert all(frame.timestamp_s == pytest.approx(frame.index / 10) for frame in backend.seen)
    again = Told(moved(truth))
    measured(again, tmp_path, truth, repeat=1, seeds=[0, 1], **constant(loss=0.4))
    assert [frame.index for frame in again.seen] != seen  # another repeat has other luck


def test_slam_that_is_slower_than_the_camera_skips_frames(tmp_path: Path) -> None:
    truth = helix(COUNT)
    backend = Told(moved(truth))
    measured(backend, tmp_path, truth, link="ideal", slam_ms=250)
    assert [frame.index for frame in backend.seen][:5] == [0, 2, 5, 7, 10]


def test_slam_takes_the_time_that_was_measured_on_a_slower_machine(tmp_path: Path) -> None:
    backend = Told(moved(helix(COUNT)))
    inputs = {"slam_ms": 125.0}
    measured(backend, tmp_path, link="ideal", slam_ms="measured", receiver_factor=2.0, inputs=inputs)
    assert [frame.index for frame in backend.seen][:5] == [0, 2, 5, 7, 10]


def test_a_start_offset_begins_in_the_middle(tmp_path: Path) -> None:
    truth = helix(COUNT)
    backend = Told(part(moved(truth), np.arange(20, COUNT)))
    found = measured(backend, tmp_path, truth, start_offsets=[20], link="ideal")
    assert [frame.index for frame in backend.seen] == list(range(20, COUNT))
    assert found["live_position_error_m"].value == pytest.approx(0.0, abs=1e-9)
    assert found["sent_size_bytes"].value == (COUNT - 20) * 88


def test_a_timeline_is_left_beside_the_record(tmp_path: Path) -> None:
    truth = helix(COUNT)
    measured(Told(moved(truth)), tmp_path, truth, **constant(delay_ms=200, loss=0.3))
    with (tmp_path / "live.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == COUNT
    assert {row["fate"] for row in rows} == {"on time", "lost"}
    came = [row for row in rows if row["fate"] == "on time"]
    assert all(float(row["delivered_s"]) == pytest.approx(float(row["taken_s"]) + 0.2, abs=1e-4) for row in came)
    assert rows[0]["x"] == ""
    assert rows[-1]["x"] != ""


def test_what_is_drawn_over_a_link_is_the_live_error(tmp_path: Path) -> None:
    truth = helix(COUNT)
    over = constant(delay_ms=250, loss=0.3)
    found = measured(Told(moved(truth)), tmp_path, truth, start_offsets=[5], **over)
    drawn = TrajectoryEvaluator.create(backend="told", start_offsets=[5], **over).drawing(
        Outcome(0, tuple(found.values()), tmp_path)
    )
    assert drawn is not None
    assert drawn.timeline is not None
    assert drawn.timeline.frames.tolist() == list(range(5, COUNT))
    errors_m = drawn.timeline.errors
    assert np.isnan(errors_m[:3]).all(), "no picture was there yet"
    known = errors_m[~np.isnan(errors_m)]
    assert rms(known) == pytest.approx(found["live_position_error_m"].value, rel=1e-4)
    rows = {row.name: row.holds for row in drawn.timeline.rows}
    assert list(rows) == ["on time", "lost", "tracked"]
    assert np.array_equal(rows["on time"], ~rows["lost"])
    assert np.array_equal(rows["tracked"], rows["on time"]), "the told poses are of every frame that was read"


def test_without_ground_truth_there_is_no_live_error(tmp_path: Path) -> None:
    found = measured(Told(moved(helix(COUNT))), tmp_path, link="ideal")
    for metric in ("live_position_error_m", "idle_error_m"):
        assert found[metric].reason == "the sequence has no ground truth"
    assert found["fresh_pose_fraction"].value == 1.0


def test_a_link_is_judged_by_a_limit_and_not_beside_raw_frames(tmp_path: Path) -> None:
    truth = helix(COUNT)
    found = measured(Told(moved(truth)), tmp_path, truth, link="ideal")
    run = Outcome(0, tuple(found.values()), tmp_path)
    verdicts = {
        m.metric: m
        for m in TrajectoryEvaluator.create(backend="told", link="ideal", ate_limit_m=0.1).compare(run, [run])
    }
    assert verdicts["success"].value == 1.0
    assert "over a link" in str(verdicts["ate_to_raw_m"].reason)


def test_a_matrix_without_a_link_has_the_identities_that_it_had() -> None:
    evaluator = TrajectoryEvaluator.create(seeds=[3])
    identity = without_defaults(evaluator.repeat_identity(0), evaluator.params)
    assert identity == {"start_offset": 0, "seed": 3}
    assert [use.kind for use in evaluator.uses] == ["slam_backend"]
    over_link = TrajectoryEvaluator.create(link="ideal")
    assert without_defaults(over_link.repeat_identity(0), over_link.params)["link"] == "ideal"
    assert [use.kind for use in over_link.uses] == ["slam_backend", "link"]


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"slam_ms": 5}, "slam_ms needs a link"),
        ({"mtu": 500}, "mtu needs a link"),
        ({"link": "ideal", "architecture": "atc"}, "atc over a link is not simulated"),
    ],
)
def test_what_has_no_meaning_is_refused(params: dict[str, Any], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        TrajectoryEvaluator.create(**params)
