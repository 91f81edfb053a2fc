"""The time that is left, of work whose cost is known."""

from __future__ import annotations

import itertools

import pytest

from codecbench.core.engine.planning.estimate import START_S, TYPICAL_CELL_S
from codecbench.core.engine.planning.model import Cell, CodingJob, PluginSetting, SequenceEntry
from codecbench.core.engine.running.progress import Pace, Progress, headline_words
from codecbench.core.engine.storage.record import Record

COSTS_S = {"raw": 0.5, "slow": 20.0}
"""What a frame costs under each codec, whatever reads it."""


def test_what_a_cell_measured_is_its_headlines_in_the_units_that_people_are_shown() -> None:
    shown = {"aggregates": ["mean"], "headline": True, "display_unit": "1", "display_factor": 1.0}
    declared = {
        "evaluators": {
            "tracking": {
                "metrics": [
                    {**shown, "name": "error_m", "label": "error", "display_unit": "cm", "display_factor": 100.0},
                    {**shown, "name": "share", "label": "tracked"},
                    {**shown, "name": "infinite", "label": "PSNR"},
                    {**shown, "name": "detail", "label": "detail", "headline": False},
                ]
            }
        }
    }
    summaries = {("error_m", "", "mean"): 0.01234, ("share", "", "mean"): 0.9, ("infinite", "", "mean"): float("inf")}
    of, record = cell(5, "raw", "tracking"), Record("id", "ok", summaries={**summaries, ("detail", "", "mean"): 1.0})
    assert headline_words(of, record, declared).split(", ") == ["raw: error 1.23 cm", "tracked 0.9"]
    assert headline_words(of, record, {}) == ""


def sequence(frames: int) -> SequenceEntry:
    return SequenceEntry(f"of {frames}", PluginSetting("dataset", "d", "1"), str(frames), frames, 1, False, False)


def cell(frames: int, codec: str, evaluator: str, *, exclusive: bool = False) -> Cell:
    settings = PluginSetting("codec", codec, "1"), PluginSetting("evaluator", evaluator, "1")
    return Cell(f"{frames} {codec} {evaluator}", sequence(frames), *settings, 0, 0, exclusive, None)


def test_nothing_is_said_before_anything_has_ended() -> None:
    pace = Pace(1)
    pace.expect([], [cell(5, "raw", "tracking")])
    assert pace.remaining_s() is None


def test_frames_times_what_a_frame_of_that_kind_took() -> None:
    pace, done, left = Pace(2), cell(10, "raw", "tracking"), cell(100, "raw", "tracking")
    pace.expect([], [done, left])
    pace.finish(done, 30.0)
    assert pace.remaining_s() == pytest.approx(100 * 3.0 / 2)


def test_what_runs_alone_has_one_worker() -> None:
    pace, done, left = Pace(2), cell(10, "raw", "timing", exclusive=True), cell(100, "raw", "timing", exclusive=True)
    pace.expect([], [done, left])
    pace.finish(done, 30.0)
    assert pace.remaining_s() == pytest.approx(300.0)


def test_a_slow_codec_says_nothing_of_a_fast_one() -> None:
    """Whatever ends first, the estimate is right as soon as each kind was seen once, and never leaves what can be."""
    cells = [cell(frames, codec, "tracking") for frames in (10, 20, 40) for codec in COSTS_S]
    for order in itertools.permutations(cells):
        pace = Pace(1)
        pace.expect([], cells)
        for number, each in enumerate(order):
            pace.finish(each, each.sequence.frames * COSTS_S[each.codec.name])
            truth = sum(other.sequence.frames * COSTS_S[other.codec.name] for other in order[number + 1 :])
            seen = {other.codec.name for other in order[: number + 1]}
            if seen == set(COSTS_S):
                assert pace.remaining_s() == pytest.approx(truth)


def test_an_evaluator_that_was_not_seen_costs_what_it_declares_at_the_pace_of_the_others() -> None:
    pace = Pace(1, {"quality": 10.0, "tracking": 100.0})
    done, left = cell(10, "raw", "quality"), cell(10, "raw", "tracking")
    pace.expect([], [done, left])
    pace.finish(done, 0.3)  # three times what it declares
    assert pace.remaining_s() == pytest.approx(10 * 0.1 * 3)


def test_an_evaluator_that_declares_nothing_is_taken_to_look_at_a_few_frames_until_it_is_seen() -> None:
    pace = Pace(1)
    done, sample = cell(1000, "raw", "tracking"), [cell(1000, codec, "sample") for codec in COSTS_S]
    pace.expect([], [done, *sample])
    pace.finish(done, 500.0)
    assert pace.remaining_s() == pytest.approx(2 * TYPICAL_CELL_S)
    pace.finish(sample[0], 40.0)
    assert pace.remaining_s() == pytest.approx(40.0)


def test_encoding_is_a_kind_of_its_own() -> None:
    pace = Pace(1)
    jobs = [CodingJob(name, sequence(10), PluginSetting("codec", name, "1")) for name in COSTS_S]
    left = cell(10, "raw", "tracking")
    pace.expect(jobs, [left])
    pace.finish(jobs[0], 1.0)
    pace.finish(jobs[1], 100.0)
    pace.finish(left, 7.0)
    assert pace.remaining_s() == 0.0


def test_what_a_worker_takes_to_begin_does_not_make_a_short_run_a_long_one() -> None:
    """Twenty frames at 20 ms: in each of two workers the first cell of an evaluator takes 3 s longer."""
    pace = Pace(2, {"quality": 30.0, "features": 40.0})
    cells = [cell(20, codec, task) for task in ("quality", "features") for codec in "abcdefgh"]
    pace.expect([], cells)
    truth = [0.4 + (3.0 if number % 8 < 2 else 0.0) for number in range(16)]
    for number, each in enumerate(cells):
        pace.finish(each, truth[number], worker=number % 2)
        left = sum(truth[number + 1 :]) / 2
        assert pace.remaining_s() <= 2 * left + 1.0, number
        assert pace.remaining_s() >= left / 3 - 3.0, number
    assert pace.remaining_s() == 0.0


def test_a_long_first_cell_counts_but_for_the_time_that_beginning_takes() -> None:
    pace = Pace(1, {"tracking": 30.0})
    done, left = cell(1000, "raw", "tracking"), cell(1000, "other", "tracking")
    pace.expect([], [done, left])
    pace.finish(done, 200.0, worker="a")
    assert pace.remaining_s() == pytest.approx(200.0 - START_S)


def test_the_share_that_is_done() -> None:
    moment = Progress(90, 0, 0, 16, 4, 0, elapsed_s=30.0, remaining_s=90.0)
    assert moment.share == pytest.approx(0.25)
    assert Progress(90, 90, 0, 16, 16, 0, elapsed_s=0.0, remaining_s=0.0).share == 1.0
    assert Progress(90, 0, 0, 16, 0, 0, elapsed_s=3.0, remaining_s=None).share is None
