"""The trajectory evaluator with a backend that returns what it was told to."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memory_sequence import CodedInMemory, FunctionCodec, MemorySequence, Plugins, context
from synthetic_path import CAMERA, Told, helix, moved, noisy, part

from codecbench.core.contracts.errors import SlamError, Unsupported
from codecbench.core.contracts.evaluator import Measurement, Outcome
from codecbench.core.contracts.sequence import Trajectory
from codecbench.core.contracts.slam import LoopEvent
from codecbench.plugins.evaluators.trajectory import TrajectoryEvaluator, files
from codecbench.plugins.evaluators.trajectory.alignment import Pairs, align
from codecbench.plugins.evaluators.trajectory.errors import position_errors, rms
from codecbench.plugins.evaluators.trajectory.metrics import HELD, LIVE

COUNT = 100


def coded(truth: Trajectory | None = None) -> CodedInMemory:
    """A hundred small frames whose decoded pixels are their raw pixels plus one."""
    images = [np.full((6, 8), index, np.uint8) for index in range(COUNT)]
    sequence = MemorySequence(images, CAMERA, truth)
    return CodedInMemory(sequence, FunctionCodec(lambda image: np.asarray(image + 1, dtype=np.uint8)))


def measured(
    backend: Told, folder: Path, truth: Trajectory | None = None, repeat: int = 0, **params: Any
) -> dict[str, Measurement]:
    evaluator = TrajectoryEvaluator.create(backend="told", **params)
    where = context(folder, repeat, Plugins(told=lambda _: backend))
    found = list(evaluator.evaluate(coded(truth), where))
    assert len({one.metric for one in found}) == len(found)
    return {one.metric: one for one in found}


def outcome(found: dict[str, Measurement], folder: Path, repeat: int = 0) -> Outcome:
    return Outcome(repeat, tuple(found.values()), folder)


def verdicts(run: Outcome, baseline: list[Outcome], **params: Any) -> dict[str, Measurement]:
    return {m.metric: m for m in TrajectoryEvaluator.create(backend="told", **params).compare(run, baseline)}


def folder(tmp_path: Path, name: str) -> Path:
    (tmp_path / name).mkdir()
    return tmp_path / name


def test_a_perfect_run(tmp_path: Path) -> None:
    truth = helix(COUNT)
    found = measured(Told(moved(truth), loops=(LoopEvent(60, 5, 40), LoopEvent(80, 6, 30))), tmp_path, truth)
    expected = {
        "ate_rmse_m": 0.0, "ate_median_m": 0.0, "ate_rmse_first_frame_m": 0.0, "ate_before_loops_m": 0.0,
        "initialisation_frames": 0.0, "tracked_since_map_fraction": 1.0,
        "rpe_trans_m": 0.0, "scale_drift": 0.0, "tracked_fraction": 1.0,
        "first_tracked_frame": 0.0, "times_lost": 0.0, "maps": 1.0, "maps_merged": 0.0,
        "keyframes": 20.0, "map_points": 4.0,
        "loops_closed": 2.0, "loop_frame": 60.0, "mean_inliers": 50.0, "slam_ms_per_frame": 2.0,
        "sent_size_bytes": 4800.0, "sent_rate_kbps": 3.84,
    }  # fmt: skip
    for name, value in expected.items():
        assert found[name].value == pytest.approx(value, abs=1e-9), name
    assert found["rpe_rot_deg"].value == pytest.approx(0.0, abs=1e-4)
    for name in HELD:
        assert found[name].value == pytest.approx(0.0, abs=1e-6), name


def test_truth_without_rotations_judges_positions(tmp_path: Path) -> None:
    whole = helix(COUNT)
    poses = whole.world_from_camera.copy()
    poses[:, :3, :3] = np.nan
    found = measured(Told(moved(noisy(whole, 0.02))), folder(tmp_path, "a"), Trajectory(whole.timestamps_s, poses))
    expected = measured(Told(moved(noisy(whole, 0.02))), folder(tmp_path, "b"), whole)
    undefined = {"rpe_trans_m", "rpe_rot_deg", "ate_rmse_first_frame_m"}
    for name in undefined:
        assert "positions only" in str(found[name].reason)
    for name in set(expected) - undefined:
        assert found[name].value == pytest.approx(expected[name].value, nan_ok=True), name
    written = files.read_tum(tmp_path / "a" / files.GROUND_TRUTH)
    np.testing.assert_allclose(written.positions_world, whole.positions_world, atol=1e-6)


def test_merged_maps_are_no_loops(tmp_path: Path) -> None:
    truth = helix(COUNT)
    loops = LoopEvent(20, 3, 45, merged_maps=True), LoopEvent(60, 5, 40), LoopEvent(70, 2, 50, merged_maps=True)
    found = measured(Told(moved(truth), loops=loops), tmp_path, truth)
    values = {name: found[name].value for name in ("maps_merged", "loops_closed", "loop_frame")}
    assert values == {"maps_merged": 2.0, "loops_closed": 1.0, "loop_frame": 60.0}
    with (tmp_path / files.LOOPS).open() as stream:
        assert [row["merged_maps"] for row in csv.DictReader(stream)] == ["1", "0", "1"]


def test_every_declared_metric_is_measured_and_no_other(tmp_path: Path) -> None:
    truth = helix(COUNT)
    found = measured(Told(moved(truth)), tmp_path, truth)
    evaluator = TrajectoryEvaluator.create(backend="told")
    one = outcome(found, tmp_path)
    compared = {m.metric for m in evaluator.compare(one, [one])}
    expected = {metric.name for metric in TrajectoryEvaluator.metrics} - {metric.name for metric in LIVE}
    assert set(found) | compared == expected
    assert not set(found) & compared


def test_frames_before_initialisation_and_losses_are_counted(tmp_path: Path) -> None:
    truth = helix(COUNT)
    tracked = np.r_[20:50, 60:100]
    found = measured(Told(moved(part(truth, tracked))), tmp_path, truth)
    assert found["tracked_fraction"].value == pytest.approx(0.7)
    assert found["initialisation_frames"].value == found["first_tracked_frame"].value == 20
    assert found["tracked_since_map_fraction"].value == pytest.approx(70 / 80)
    assert found["times_lost"].value == 1
    assert found["ate_rmse_m"].value == pytest.approx(0.0, abs=1e-9)
    held = np.r_[np.full(20, 20), 20:50, np.full(10, 49), 60:100]
    pairs = Pairs(Trajectory(truth.timestamps_s, truth.world_from_camera[held]), truth)
    off_m = position_errors(pairs, align(pairs))
    assert found["held_ate_m"].value == pytest.approx(rms(off_m))
    parts_m = [
        rms(off_m[:20]) * math.sqrt(0.2),
        rms(off_m[tracked]) * math.sqrt(0.7),
        rms(off_m[50:60]) * math.sqrt(0.1),
    ]
    assert [found[name].value for name in HELD[1:]] == pytest.approx(parts_m)


def test_a_trajectory_cut_to_its_first_tenth_ranks_worse(tmp_path: Path) -> None:
    truth = helix(COUNT)
    whole = moved(noisy(truth, 0.1))
    cut = measured(Told(part(whole, slice(0, 10))), folder(tmp_path, "cut"), truth)
    full = measured(Told(whole), folder(tmp_path, "full"), truth)
    assert cut["ate_rmse_m"].value < full["ate_rmse_m"].value
    assert cut["held_ate_m"].value > full["held_ate_m"].value
    evaluator = TrajectoryEvaluator.create(backend="told")
    baseline = [outcome(full, tmp_path / "full")]
    succeeded = {
        name: next(iter(evaluator.compare(outcome(found, tmp_path / name), baseline))).value
        for name, found in (("cut", cut), ("full", full))
    }
    assert succeeded == {"cut": 0.0, "full": 1.0}


def test_nothing_tracked_is_a_result(tmp_path: Path) -> None:
    truth = helix(COUNT)
    found = measured(Told(part(truth, slice(0, 0))), tmp_path, truth)
    assert found["tracked_fraction"].value == 0.0
    for name in ("ate_rmse_m", "rpe_trans_m", "scale_drift", "first_tracked_frame", "mean_inliers", "loop_frame"):
        assert math.isnan(found[name].value)
        assert found[name].reason
    spread_m = np.linalg.norm(truth.positions_world - truth.positions_world.mean(axis=0), axis=1)
    for name in ("held_ate_m", "held_waiting_m", "path_spread_m"):
        assert found[name].value == pytest.approx(rms(spread_m))
    assert (found["held_tracked_m"].value, found["held_lost_m"].value) == (0.0, 0.0)
    assert found["initialisation_frames"].value == COUNT
    assert "no map" in str(found["tracked_since_map_fraction"].reason)
    whole = measured(Told(moved(truth)), folder(tmp_path, "whole"), truth)
    compared = verdicts(outcome(found, tmp_path), [outcome(whole, tmp_path / "whole")])
    assert (compared["success"].value, compared["starts_in_time"].value) == (0.0, 0.0)
    assert math.isnan(compared["ate_to_raw_m"].value)


def test_codecs_are_not_judged_if_raw_frames_give_no_map(tmp_path: Path) -> None:
    truth = helix(COUNT)
    nothing = outcome(
        measured(Told(part(truth, slice(0, 0))), folder(tmp_path, "nothing"), truth), tmp_path / "nothing"
    )
    whole = outcome(measured(Told(moved(truth)), folder(tmp_path, "whole"), truth), tmp_path / "whole")
    for run in (nothing, whole):
        compared = verdicts(run, [nothing])
        for name in ("success", "starts_in_time", *HELD):
            assert math.isnan(compared[name].value)
            assert "no map" in str(compared[name].reason)
    assert "held_ate_m" not in verdicts(nothing, [nothing, whole])


def started(tmp_path: Path, first: int, last: int = 200, sigma_m: float = 0.01) -> Outcome:
    """A run on 200 frames that is tracked from one frame to another."""
    name = f"{first}-{last}-{sigma_m}"
    truth = helix(200)
    images = [np.full((6, 8), index, np.uint8) for index in range(200)]
    frames = CodedInMemory(MemorySequence(images, CAMERA, truth), FunctionCodec(lambda image: image))
    backend = Told(part(moved(noisy(truth, sigma_m)), slice(first, last)))
    where = context(folder(tmp_path, name), 0, Plugins(told=lambda _: backend))
    found = TrajectoryEvaluator.create(backend="told").evaluate(frames, where)
    return Outcome(0, tuple(found), tmp_path / name)


def test_one_more_frame_before_the_map_is_no_failure(tmp_path: Path) -> None:
    """Raw frames need 20 of 200 frames for a map, exactly a tenth, and a codec of less error one more."""
    raw, coded_run = started(tmp_path, 20), started(tmp_path, 21, sigma_m=0.009)
    assert (raw.value("tracked_fraction"), coded_run.value("tracked_fraction")) == (0.9, 0.895)
    assert coded_run.value("ate_rmse_m") < raw.value("ate_rmse_m")
    compared = verdicts(coded_run, [raw])
    assert (compared["success"].value, compared["starts_in_time"].value) == (1.0, 1.0)


def test_a_late_map_and_a_lost_one_fail_each_its_own_verdict(tmp_path: Path) -> None:
    raw = started(tmp_path, 20)
    late, lost = verdicts(started(tmp_path, 51), [raw]), verdicts(started(tmp_path, 20, 180), [raw])
    assert (late["success"].value, late["starts_in_time"].value) == (1.0, 0.0)
    assert (lost["success"].value, lost["starts_in_time"].value) == (0.0, 1.0)


def test_thresholds_are_the_matrix_file_s(tmp_path: Path) -> None:
    raw, late, lost = started(tmp_path, 20), started(tmp_path, 51), started(tmp_path, 20, 180)
    worse = started(tmp_path, 20, sigma_m=0.03)
    assert verdicts(late, [raw], delay_frames=31)["starts_in_time"].value == 1.0
    assert verdicts(lost, [raw], tracked_to_raw=0.8)["success"].value == 1.0
    assert verdicts(worse, [raw])["success"].value == 0.0
    assert verdicts(worse, [raw], ate_to_raw=4.0)["success"].value == 1.0
    assert verdicts(worse, [raw], ate_limit_m=0.1)["success"].value == 1.0


def test_a_run_that_loses_as_much_as_raw_frames_do_succeeds(tmp_path: Path) -> None:
    raw = started(tmp_path, 20, 120)
    assert verdicts(started(tmp_path, 20, 115), [raw])["success"].value == 1.0
    assert verdicts(started(tmp_path, 20, 100), [raw])["success"].value == 0.0


def turning(count: int) -> Trajectory:
    """A helix of which the second half is a hundred times smaller: the camera nearly only turns."""
    truth = helix(count)
    half = truth.world_from_camera[count // 2 :, :3, 3]
    half[:] = half[0] + 0.01 * (half - half[0])
    return truth


def spread_m(positions: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1))))


def test_the_spread_of_the_true_path_is_that_of_the_frames_from_the_start_on(tmp_path: Path) -> None:
    truth = turning(COUNT)
    backend = Told(part(moved(truth), slice(70, 90)))
    for repeat, offset in enumerate((0, 50)):
        found = measured(backend, folder(tmp_path, str(offset)), truth, repeat, start_offsets=[0, 50])
        assert found["path_spread_m"].value == pytest.approx(spread_m(truth.positions_world[offset:]))


def test_no_run_is_judged_from_a_start_where_raw_s_error_is_as_large_as_the_way(tmp_path: Path) -> None:
    """The way spreads over a metre from the first frame on, over 8 mm from the middle on; raw errs by 52 and 8 mm."""
    truth, offsets = turning(COUNT), {"start_offsets": [0, COUNT // 2]}
    runs = {
        name: [
            outcome(measured(Told(path), where := folder(tmp_path, f"{name}{r}"), truth, r, **offsets), where, r)
            for r in range(2)
        ]
        for name, path in (
            ("raw", moved(noisy(truth, 0.03))), ("good", moved(truth)), ("lost", part(moved(truth), slice(0, 0)))
        )
    }  # fmt: skip
    raw_m = np.median([run.value("ate_rmse_m") for run in runs["raw"]])
    way_m = spread_m(truth.positions_world[COUNT // 2 :])
    assert way_m < 2 * raw_m < 0.1
    found = {name: [verdicts(run, runs["raw"], **offsets)["success"] for run in each] for name, each in runs.items()}
    assert [each[0].value for each in found.values()] == [1.0, 1.0, 0.0]
    for verdict in (each[1] for each in found.values()):
        assert math.isnan(verdict.value)
        for fact in (f"= {2e3 * raw_m:.3g} mm", f"above {1e3 * way_m:.3g} mm", "set ate_limit_m"):
            assert fact in str(verdict.reason)
    limited = [verdicts(run[1], runs["raw"], **offsets, ate_limit_m=0.5 * way_m)["success"] for run in runs.values()]
    assert [verdict.value for verdict in limited] == [0.0, 1.0, 0.0]


def test_a_limit_above_the_spread_of_the_way_counts_as_the_spread(tmp_path: Path) -> None:
    """The camera stands for 80 frames and goes a metre in 20, the only ones that have a pose, which is of noise."""
    truth = helix(COUNT)
    truth.world_from_camera[:, :3, 3] = np.outer(np.clip((np.arange(COUNT) - 79) / 20, 0, 1), [1.0, 0.0, 0.0])
    found = {}
    for name, sigma_m in (("noise", 5.0), ("good", 0.01)):
        path = part(moved(noisy(truth, sigma_m)), slice(80, COUNT))
        run = outcome(measured(Told(path), folder(tmp_path, name), truth), tmp_path / name)
        assert run.value("path_spread_m") == pytest.approx(spread_m(truth.positions_world))
        found[name] = run, verdicts(run, [], ate_limit_m=0.5)["success"]
    noise, verdict = found["noise"]
    assert noise.value("path_spread_m") < noise.value("ate_rmse_m") < 0.5
    assert (verdict.value, found["good"][1].value) == (0.0, 1.0)
    cap = f"0.5 m) = {noise.value('path_spread_m'):.3g} m"
    assert cap in str(verdict.reason)
    assert cap in str(found["good"][1].reason)
    assert "spread" not in str(verdicts(noise, [], ate_limit_m=0.2)["success"].reason)


def test_a_run_of_an_earlier_version_is_to_be_measured_again(tmp_path: Path) -> None:
    new = started(tmp_path, 0)
    later = ("path_spread_m", *HELD[1:])
    old = Outcome(0, tuple(each for each in new.measurements if each.metric not in later), new.artifacts)
    for limit in ({}, {"ate_limit_m": 0.1}):
        found = verdicts(old, [old], **limit)["success"]
        assert math.isnan(found.value)
        assert str(found.reason).endswith("measure it again")


def test_without_ground_truth_the_rest_is_there(tmp_path: Path) -> None:
    path = helix(COUNT)
    raw = measured(Told(moved(path)), folder(tmp_path, "raw"))
    assert raw["tracked_fraction"].value == 1.0
    for name in ("ate_rmse_m", *HELD, "path_spread_m"):
        assert math.isnan(raw[name].value)
        assert "no ground truth" in str(raw[name].reason)
    other = measured(Told(moved(noisy(path, 0.02), scale=5.0)), folder(tmp_path, "other"))
    evaluator = TrajectoryEvaluator.create(backend="told")
    compared = {
        m.metric: m for m in evaluator.compare(outcome(other, tmp_path / "other"), [outcome(raw, tmp_path / "raw")])
    }
    assert compared["ate_to_raw_m"].value == pytest.approx(0.3 * 0.02 * math.sqrt(3), rel=0.15)  # in the raw map's unit
    assert compared["success"].reason
    assert compared["ate_minus_raw_m"].reason
    assert not (tmp_path / "raw" / files.GROUND_TRUTH).exists()


def runs_of_raw(tmp_path: Path, *sigmas_m: float) -> list[Outcome]:
    """Runs without ground truth, each in a unit and frame of its own, this much off the path that was walked."""
    made = []
    for repeat, sigma_m in enumerate(sigmas_m):
        where, path = folder(tmp_path, f"raw{repeat}"), moved(noisy(helix(COUNT), sigma_m, repeat), scale=2.0 + repeat)
        made.append(outcome(measured(Told(path), where), where, repeat))
    return made


def off_path(tmp_path: Path, sigma_m: float, repeat: int = 0) -> Outcome:
    where = folder(tmp_path, f"coded {sigma_m} {repeat}")
    return outcome(measured(Told(moved(noisy(helix(COUNT), sigma_m, 9))), where), where, repeat)


def test_raw_s_paths_stand_in_for_the_ground_truth(tmp_path: Path) -> None:
    """Noise of two paths adds up in squares, and the share of the length is the same in every unit."""
    raw = runs_of_raw(tmp_path, 0.01, 0.01, 0.01)
    length_m = np.linalg.norm(np.diff(noisy(helix(COUNT), 0.01, 0).positions_world, axis=0), axis=1).sum()
    for run, apart_m in ((raw[0], 0.01 * math.sqrt(2)), (off_path(tmp_path, 0.05), math.hypot(0.05, 0.01))):
        found = verdicts(run, raw)["raw_path_error_percent"].value
        assert found == pytest.approx(100 * math.sqrt(3) * apart_m / length_m, rel=0.1)


def test_without_truth_a_path_succeeds_that_is_about_as_near_as_raw_s_own(tmp_path: Path) -> None:
    raw = runs_of_raw(tmp_path, 0.01, 0.01, 0.01)
    near, far = off_path(tmp_path, 0.02), off_path(tmp_path, 0.1)
    assert [verdicts(run, raw)["success"].value for run in (raw[1], near, far)] == [1.0, 1.0, 0.0]
    assert verdicts(far, raw, ate_to_raw=20.0)["success"].value == 1.0


def test_raw_paths_that_disagree_and_a_single_one_give_no_verdict(tmp_path: Path) -> None:
    wild = runs_of_raw(tmp_path, 0.05, 0.05, 0.05)
    apart = verdicts(wild[0], wild)["raw_path_error_percent"].value
    strict = verdicts(wild[0], wild, raw_agrees_percent=apart / 2)["success"]
    assert "raw_agrees_percent" in str(strict.reason)
    assert verdicts(wild[0], wild, raw_agrees_percent=apart * 2)["success"].value == 1.0
    single = verdicts(off_path(tmp_path, 0.02), wild[:1])
    assert "set start_offsets" in str(single["success"].reason)
    assert "set several start_offsets" in str(single["raw_path_error_percent"].reason)


def test_comparison_with_raw_pairs_repeats(tmp_path: Path) -> None:
    truth = helix(COUNT)
    evaluator = TrajectoryEvaluator.create(backend="told", start_offsets=[0, 1, 2])
    raw = [
        outcome(
            measured(Told(moved(noisy(truth, 0.01 * (r + 1)))), folder(tmp_path, f"raw{r}"), truth),
            tmp_path / f"raw{r}",
            r,
        )
        for r in range(3)
    ]
    coded_run = outcome(
        measured(Told(moved(noisy(truth, 0.05, seed=9))), folder(tmp_path, "jpeg"), truth), tmp_path / "jpeg", 1
    )
    compared = {m.metric: m.value for m in evaluator.compare(coded_run, raw)}
    assert compared["ate_minus_raw_m"] == pytest.approx(coded_run.value("ate_rmse_m") - raw[1].value("ate_rmse_m"))
    assert compared["success"] == 0.0
    assert compared["ate_to_raw_m"] == pytest.approx(math.hypot(0.05, 0.02) * math.sqrt(3), rel=0.1)
    own = {m.metric: m.value for m in evaluator.compare(raw[2], raw)}
    assert math.isnan(own.pop("raw_path_error_percent"))
    nothing = {"ate_to_raw_m": pytest.approx(0.0, abs=1e-6), "ate_minus_raw_m": 0.0}
    assert own == {"success": 1.0, "starts_in_time": 1.0, **nothing}


@pytest.mark.parametrize(("limit_m", "verdict"), [(0.2, 1.0), (0.01, 0.0)])
def test_an_absolute_limit_needs_no_raw_run(limit_m: float, verdict: float, tmp_path: Path) -> None:
    truth = helix(COUNT)
    found = measured(Told(moved(noisy(truth, 0.05))), tmp_path, truth)
    evaluator = TrajectoryEvaluator.create(backend="told", ate_limit_m=limit_m)
    compared = {m.metric: m for m in evaluator.compare(outcome(found, tmp_path), [])}
    assert compared["success"].value == verdict
    assert "raw codec" in str(compared["ate_to_raw_m"].reason)
    without = TrajectoryEvaluator.create(backend="told")
    assert "ate_limit_m" in str(next(iter(without.compare(outcome(found, tmp_path), []))).reason)


def test_a_run_that_stands_still_fails(tmp_path: Path) -> None:
    truth = helix(COUNT)
    still = Trajectory(truth.timestamps_s, np.tile(np.eye(4), (COUNT, 1, 1)))
    found = measured(Told(still), tmp_path, truth)
    assert found["tracked_fraction"].value == 1.0
    verdict = next(iter(TrajectoryEvaluator.create(ate_limit_m=1.0).compare(outcome(found, tmp_path), [])))
    assert verdict.value == 0.0


def test_cta_sees_decoded_frames_and_sends_all(tmp_path: Path) -> None:
    backend = Told(helix(COUNT))
    found = measured(backend, tmp_path, helix(COUNT), architecture="cta")
    assert [int(frame.image[0, 0]) for frame in backend.seen] == list(range(1, COUNT + 1))
    assert backend.keyframe_images == []
    assert found["sent_size_bytes"].value == 48 * COUNT


def test_atc_tracks_raw_frames_and_sends_keyframes(tmp_path: Path) -> None:
    backend = Told(helix(COUNT))
    found = measured(backend, tmp_path, helix(COUNT), architecture="atc")
    assert [int(frame.image[0, 0]) for frame in backend.seen] == list(range(COUNT))
    assert [int(image[0, 0]) for image in backend.keyframe_images] == list(range(1, COUNT + 1, 5))
    assert found["sent_size_bytes"].value == 48 * 20
    assert found["sent_rate_kbps"].value == pytest.approx(48 * 20 * 8 / 10.0 / 1000)


def test_offsets_and_seeds_make_repeats(tmp_path: Path) -> None:
    backend = Told(helix(COUNT))
    evaluator = TrajectoryEvaluator.create(start_offsets=[0, 5], seeds=[3, 4])
    assert evaluator.repeats == 4
    for repeat, (offset, seed) in enumerate([(0, 3), (5, 3), (0, 4), (5, 4)]):
        measured(backend, folder(tmp_path, str(repeat)), repeat=repeat, start_offsets=[0, 5], seeds=[3, 4])
        assert backend.seen[0].index == offset
        assert backend.seeds[-1] == seed


def test_longer_lists_of_repeats_and_other_thresholds_change_no_identity() -> None:
    short = TrajectoryEvaluator.create(start_offsets=[0, 5], backend_params={"features": 500})
    thresholds = {
        "ate_limit_m": 0.5, "ate_to_raw": 3.0, "tracked_to_raw": 0.5, "delay_frames": 5, "raw_agrees_percent": 1.0,
    }  # fmt: skip
    longer = TrajectoryEvaluator.create(start_offsets=[0, 5, 10], backend_params={"features": 500}, **thresholds)
    assert [short.repeat_identity(i) for i in range(2)] == [longer.repeat_identity(i) for i in range(2)]
    assert longer.repeat_identity(1) != longer.repeat_identity(2)
    other = TrajectoryEvaluator.create(start_offsets=[0, 5], architecture="atc", backend_params={"features": 500})
    assert other.repeat_identity(0) != short.repeat_identity(0)


@pytest.mark.parametrize(
    "params", [{"start_offsets": [1, 1]}, {"start_offsets": []}, {"seeds": [-1]}, {"architecture": "both"}]
)
def test_wrong_parameters_are_refused(params: dict[str, Any]) -> None:
    with pytest.raises(ValueError):
        TrajectoryEvaluator.create(**params)


def test_what_cannot_run_is_unsupported(tmp_path: Path) -> None:
    with pytest.raises(Unsupported, match="start offset 100"):
        measured(Told(helix(COUNT)), tmp_path, start_offsets=[100])
    backend = Told(helix(COUNT))
    backend.architectures = frozenset({"cta"})  # type: ignore[misc]
    with pytest.raises(Unsupported, match="atc; it runs cta"):
        measured(backend, tmp_path, architecture="atc")


def test_impossible_answers_are_refused(tmp_path: Path) -> None:
    broken = helix(COUNT)
    broken.world_from_camera[3, 0, 3] = np.nan
    with pytest.raises(SlamError, match=r"trajectory .* not finite"):
        measured(Told(broken), tmp_path)


def test_files_beside_the_record(tmp_path: Path) -> None:
    truth = helix(COUNT)
    before = moved(noisy(truth, 0.1))
    found = measured(Told(moved(truth), before, loops=(LoopEvent(60, 5, 40),)), tmp_path, truth)
    assert found["ate_before_loops_m"].value > 0.1 > found["ate_rmse_m"].value
    final = files.read_tum(tmp_path / files.TRAJECTORY)
    np.testing.assert_allclose(final.world_from_camera, truth.world_from_camera, atol=1e-6)
    np.testing.assert_allclose(final.timestamps_s, truth.timestamps_s, atol=1e-6)
    keyframes = files.read_tum(tmp_path / files.KEYFRAMES)
    np.testing.assert_allclose(keyframes.timestamps_s, truth.timestamps_s[::5], atol=1e-6)
    assert len(files.read_tum(tmp_path / files.TRAJECTORY_BEFORE_LOOPS)) == COUNT
    assert len(files.read_tum(tmp_path / files.GROUND_TRUTH)) == COUNT
    with (tmp_path / files.STATES).open() as stream:
        rows = list(csv.DictReader(stream))
    assert [int(row["frame"]) for row in rows] == list(range(COUNT))
    assert sum(int(row["keyframe"]) for row in rows) == 20
    with (tmp_path / files.LOOPS).open() as stream:
        assert list(csv.DictReader(stream)) == [
            {"frame": "60", "matched_frame": "5", "inliers": "40", "merged_maps": "0"}
        ]


def test_map_points_are_a_ply_file_in_the_true_frame(tmp_path: Path) -> None:
    from codecbench.plugins.evaluators.trajectory.alignment import align, associate

    truth = helix(COUNT)
    measured(Told(moved(truth)), tmp_path, truth)
    header, _, body = (tmp_path / files.MAP_POINTS).read_bytes().partition(b"end_header\n")
    assert b"element vertex 4\n" in header
    similarity = align(associate(moved(truth), truth, 0.02))
    points = np.frombuffer(body, "<f4").reshape(-1, 3)
    np.testing.assert_allclose(points, similarity.points(np.arange(12.0).reshape(4, 3)), rtol=1e-5, atol=1e-4)


def test_empty_trajectories_survive_the_files(tmp_path: Path) -> None:
    empty = part(helix(5), slice(0, 0))
    files.write_tum(tmp_path / "empty.txt", empty)
    assert len(files.read_tum(tmp_path / "empty.txt")) == 0
