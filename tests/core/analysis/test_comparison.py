"""Comparisons: exact where values repeat, statistical where they do not, silent on equal code."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from codecbench.core.analysis.comparison import Comparison, Series, Snapshot, compare, read_snapshot, write_snapshot
from codecbench.core.contracts.errors import StoreError

MACHINE = ("a processor, 2 cores, here",)


YARDSTICK = "work_ms"


def series(
    metric: str, values: tuple[float, ...], *, better: str = "higher", repeatable: bool = True, unit: str = "1",
    confirmed_by: str = "", in_units_of: str = "",
) -> Series:  # fmt: skip
    return Series(
        "room", "jpeg", "quality=10", "test", metric, better, repeatable, values, "ok", "", "f00d",
        unit, confirmed_by, in_units_of,
    )  # fmt: skip


def snapshot(*members: Series, machines: tuple[str, ...] = MACHINE) -> Snapshot:
    return Snapshot("run", machines, members)


def only(found: list[Comparison]) -> Comparison:
    (one,) = found
    return one


@pytest.mark.parametrize(
    ("before", "after", "better", "verdict"),
    [
        (30.0, 30.0, "higher", "same"),
        (30.0, 29.9, "higher", "worse"),
        (30.0, 30.1, "higher", "better"),
        (1000.0, 1001.0, "lower", "worse"),
        (1000.0, 999.0, "lower", "better"),
        (5.0, 6.0, "neither", "changed"),
        (math.nan, math.nan, "higher", "same"),
        (30.0, math.nan, "higher", "changed"),
        (math.inf, math.inf, "higher", "same"),
    ],
)
def test_what_repeats_is_compared_exactly(before: float, after: float, better: str, verdict: str) -> None:
    found = compare(snapshot(series("m", (before,), better=better)), snapshot(series("m", (after,), better=better)))
    assert only(found).verdict == verdict


def test_a_tenth_of_a_decibel_is_caught_and_said() -> None:
    one = only(compare(snapshot(series("psnr_gray_db", (34.5,))), snapshot(series("psnr_gray_db", (34.4,)))))
    assert one.verdict == "worse"
    assert one.change == pytest.approx(-0.1)


def timed(rng: np.random.Generator, factor: float, drift: float, repeats: int = 5) -> Snapshot:
    """Times of a codec and of the yardstick on a machine that slows down by `drift` over the run, with 1 % noise."""
    pace = np.linspace(1.0, 1.0 + drift, repeats) * rng.uniform(0.9, 1.1)
    times = 8.0 * factor * pace * rng.normal(1.0, 0.01, repeats)
    yardstick = 2.0 * pace * rng.normal(1.0, 0.01, repeats)
    return snapshot(
        series("encode", tuple(times), better="lower", repeatable=False, unit="ms", in_units_of=YARDSTICK),
        series(YARDSTICK, tuple(yardstick), better="neither", repeatable=False),
    )


def test_equal_code_raises_no_alarm_in_twenty_trials_on_a_machine_that_drifts(rng: np.random.Generator) -> None:
    for _ in range(20):
        one = only(compare(timed(rng, 1.0, 0.15), timed(rng, 1.0, 0.0)))
        assert one.verdict in ("same", "inconclusive"), one


def test_a_slowdown_of_ten_percent_is_caught_on_a_machine_that_drifts(rng: np.random.Generator) -> None:
    verdicts = [only(compare(timed(rng, 1.0, 0.1), timed(rng, 1.1, 0.0))).verdict for _ in range(20)]
    assert verdicts.count("worse") >= 19
    assert only(compare(timed(rng, 1.1, 0.1), timed(rng, 1.0, 0.0))).verdict == "better"


def test_a_change_of_microseconds_is_not_claimed() -> None:
    def times(ms: float) -> Snapshot:
        values = tuple(ms * (1.0 + 0.001 * k) for k in range(5))
        return snapshot(series("decode", values, better="lower", repeatable=False, unit="ms"))

    assert only(compare(times(0.032), times(0.036))).verdict == "same"
    assert only(compare(times(0.32), times(0.36))).verdict == "worse"


def test_rates_of_work_are_better_when_higher(rng: np.random.Generator) -> None:
    slow = series("pace", tuple(rng.normal(30, 0.2, 5)), repeatable=False)
    fast = replace(slow, values=tuple(1.3 * value for value in slow.values))
    assert only(compare(snapshot(slow), snapshot(fast))).verdict == "better"
    assert only(compare(snapshot(fast), snapshot(slow))).verdict == "worse"


def test_few_repeats_and_other_machines_and_frames_are_inconclusive(rng: np.random.Generator) -> None:
    few = compare(timed(rng, 1.0, 0.0, repeats=4), timed(rng, 2.0, 0.0, repeats=4))
    assert "at least 5" in only(few).note
    elsewhere = replace(timed(rng, 2.0, 0.0), machines=("another",))
    assert only(compare(timed(rng, 1.0, 0.0), elsewhere)).note.startswith("another machine")
    other = replace(series("m", (1.0,)), fingerprint="beef")
    assert "different frames" in only(compare(snapshot(series("m", (1.0,))), snapshot(other))).note


def test_failures_and_absences_are_verdicts() -> None:
    good, bad = series("m", (1.0,)), replace(series("m", ()), status="crashed", reason="SIGSEGV")
    assert only(compare(snapshot(good), snapshot(bad))).verdict == "worse"
    assert only(compare(snapshot(bad), snapshot(good))).verdict == "better"
    assert only(compare(snapshot(good), snapshot())).note.endswith("the second run")


def test_patterns_choose_metrics() -> None:
    both = snapshot(series("psnr_gray_db", (1.0,)), series("size_bytes", (2.0,)))
    assert only(compare(both, both, metrics=["test.psnr*"])).key[4] == "psnr_gray_db"


def test_a_baseline_file_survives_and_a_damaged_one_is_refused(tmp_path: Path) -> None:
    whole = snapshot(series("psnr", (math.inf, math.nan, 3.25)), series("size", (1.0,), better="lower"))
    write_snapshot(whole, tmp_path / "baseline.json")
    again = read_snapshot(tmp_path / "baseline.json")
    assert all(one.verdict == "same" for one in compare(whole, again))
    for content in ("", "{}", '{"format": 99}', "no json"):
        (tmp_path / "bad.json").write_text(content)
        with pytest.raises(StoreError, match="not a baseline"):
            read_snapshot(tmp_path / "bad.json")
    with pytest.raises(StoreError, match="neither a run folder"):
        read_snapshot(tmp_path / "nothing")


@pytest.mark.parametrize(("cpu_factor", "verdict"), [(1.0, "inconclusive"), (1.3, "worse")])
def test_time_on_the_wall_needs_the_support_of_processor_time(
    rng: np.random.Generator, cpu_factor: float, verdict: str
) -> None:
    """Another program that runs for the whole of one run slows its wall clock alone."""
    wall = series("wall", tuple(rng.normal(7, 0.02, 7)), better="lower", repeatable=False, confirmed_by="cpu")
    rate = series("pace", tuple(rng.normal(40, 0.1, 7)), repeatable=False, confirmed_by="cpu")
    cpu = series("cpu", tuple(rng.normal(6, 0.02, 7)), better="lower", repeatable=False)
    after = snapshot(
        replace(wall, values=tuple(1.3 * value for value in wall.values)),
        replace(rate, values=tuple(value / 1.3 for value in rate.values)),
        replace(cpu, values=tuple(cpu_factor * value for value in cpu.values)),
    )
    found = {one.key[4]: one for one in compare(snapshot(wall, rate, cpu), after)}
    assert found["wall"].verdict == found["pace"].verdict == verdict
    assert ("other programs" in found["wall"].note) == (verdict == "inconclusive")
    assert only(compare(snapshot(wall, cpu), after, metrics=["*.wall"])).verdict == verdict


def test_a_baseline_of_an_earlier_version_takes_its_meaning_from_the_run_beside_it(
    rng: np.random.Generator, tmp_path: Path
) -> None:
    before = timed(rng, 1.0, 0.15)
    write_snapshot(before, tmp_path / "baseline.json")
    head, *lines = (tmp_path / "baseline.json").read_text().splitlines()
    unknown = ("unit", "confirmed_by", "in_units_of")
    stripped = [
        json.dumps({key: value for key, value in json.loads(line).items() if key not in unknown}) for line in lines
    ]
    (tmp_path / "old.json").write_text("\n".join([head, *stripped]) + "\n")
    after = timed(rng, 1.0, 0.0)
    assert compare(read_snapshot(tmp_path / "old.json"), after) == compare(before, after)


def test_a_run_beside_itself_is_the_same_times_too() -> None:
    """However few repeats there are: two runs never take the same time to the last bit."""
    times = series("t", (1.25, 1.5), better="lower", repeatable=False, unit="ms")
    assert only(compare(snapshot(times), snapshot(times))).verdict == "same"
    other = replace(times, values=(1.25, 1.5000001))
    assert only(compare(snapshot(times), snapshot(other))).verdict == "inconclusive"
