"""How long a plan may take: from what was measured, and before that from what evaluators declare."""

from __future__ import annotations

from dataclasses import replace

import pytest

from codecbench.core.engine.planning.estimate import estimate
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting, RunSettings, SequenceEntry

SEQUENCE = SequenceEntry("s", PluginSetting("dataset", "d", "1"), "f00d", 1000, 1, False, False)


def plan(typical_ms: float | None) -> Plan:
    codec, evaluator = PluginSetting("codec", "c", "1"), PluginSetting("evaluator", "e", "1", {}, "n=1")
    cells = tuple(Cell(f"cell{n}", SEQUENCE, codec, evaluator, n, 0, False, None) for n in range(3))
    meant = {} if typical_ms is None else {"evaluators": {"e(n=1)": {"typical_ms_per_frame": typical_ms}}}
    run = RunSettings(2, 1.0, 1, 0, PluginSetting("executor", "here", "1"))
    return Plan("p", "", run, (SEQUENCE,), (), cells, meant)


def seconds(typical_ms: float | None, durations: dict[str, float], missing: int = 2) -> float:
    made = plan(typical_ms)
    return estimate(made, list(made.cells[:missing]), 0, durations).seconds


def test_what_an_evaluator_declares_is_counted_a_frame_and_shared_by_the_workers() -> None:
    start = seconds(0.0, {})
    assert seconds(40.0, {}) - start == pytest.approx(2 * 1000 * 0.040 / 2)


def test_without_a_word_a_cell_is_taken_to_look_at_a_few_frames() -> None:
    assert seconds(0.0, {}) < seconds(None, {}) < seconds(40.0, {})
    assert seconds(None, {}, missing=0) == 0.0


def test_what_was_measured_comes_before_what_was_declared() -> None:
    start = seconds(0.0, {})
    assert seconds(40.0, {"cell2": 7.0}) - start == pytest.approx(7.0)


def test_what_is_declared_is_scaled_by_what_was_measured_of_others() -> None:
    made = plan(40.0)
    other = [replace(cell, id=f"other {cell.id}", codec=PluginSetting("codec", "other", "1")) for cell in made.cells]
    made = replace(made, cells=(*made.cells, *other))
    start = estimate(made, other[:1], 0, {}).seconds - 40.0 / 2
    assert estimate(made, other[:1], 0, {"cell0": 60.0}).seconds - start == pytest.approx(60.0 / 2)
    coded = estimate(made, other[:1], 2, {}).seconds - estimate(made, other[:1], 0, {}).seconds
    slow = [estimate(made, other[:1], jobs, {"cell0": 80.0}).seconds for jobs in (0, 2)]
    assert slow[1] - slow[0] == pytest.approx(2 * coded)
