"""The edge of a codec whose settings pass from a known one on: what is found, what is computed, what is said."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
from search_bench import SearchBench, size_of
from told import numbers

from codecbench.core.analysis.collect import open_run
from codecbench.core.engine.planning.model import Cell
from codecbench.core.report.answers import answers
from codecbench.core.rounds import growth

EVALUATORS = "scales, {use: toss, params: {runs: 4}}, {use: sight, params: {runs: 3}}, lag"
ENTRY = "{use: dial, params: {level: {range: [1, 15]}}, search: passes}"


def matrix(entry: str = ENTRY, evaluators: str = EVALUATORS, sequences: str = "flat") -> str:
    return f"""
version: 1
name: sought
sequences: [{sequences}]
codecs: [{{use: still, params: {{level: 100}}}}, {entry}]
evaluators: [{evaluators}]
run: {{workers: 1}}
"""


class World:
    """Settings are seen from one level on, and caught from another."""

    def __init__(self, seen: int, caught: int) -> None:
        self.seen, self.caught = seen, caught

    def __call__(self, cell: Cell) -> float:
        level = cell.codec.params["level"] - cell.sequence.dataset.params["gray"]
        return {
            "scales": size_of(cell), "toss": float(level >= self.caught),
            "sight": 0.95 if level >= self.seen else 0.5, "lag": 2.0,
        }[cell.evaluator.name]  # fmt: skip


@pytest.fixture
def bench(tmp_path: Path) -> SearchBench:
    return SearchBench(tmp_path)


@pytest.mark.parametrize("seen", [1, 6, pytest.param(15, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("caught", [1, 9, pytest.param(14, marks=pytest.mark.thorough)])
def test_the_edge_is_the_coarsest_setting_that_passes(bench: SearchBench, seen: int, caught: int) -> None:
    (found,) = bench.run(matrix(), World(seen, caught))
    assert (found.objective, found.state, found.setting) == ("passes", "found", f"level={max(seen, caught)}")
    assert len(set(bench.levels("sight"))) <= 1 + 4 + 3
    assert len(set(bench.levels("toss"))) <= 1 + 1 + (4 if caught > seen else 0)


def test_success_is_asked_of_the_edge_alone_and_everything_of_what_was_found(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(), World(6, 3))
    assert found.words.startswith("level=6 passes (caught 4/4")
    assert "; level=5 fails (seen 0.5" in found.words
    assert numbers(found.words) == [6.0, 4.0, 4.0, 51.0, 95.0, 0.95, 0.9, 5.0, 0.5, 0.9, 4.0, 15.0]
    assert set(bench.levels("sight")) == {100, 8, 4, 6, 5}
    assert bench.levels("toss") == [100] * 4 + [6] * 4
    assert bench.levels("lag") == [100, 6]


def test_the_last_line_names_the_edge(bench: SearchBench) -> None:
    bench.run(matrix(), World(6, 3))
    assert answers(open_run(bench.folder / "run", bench.registry)).sentence.startswith("Use dial level=6: 28 bytes")


def test_the_end_of_the_axis_is_named(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(), World(0, 0))
    assert found.setting == "level=1"
    assert "the axis; 4 of 15" in found.words
    assert set(bench.levels("toss")) == {100, 1}


def test_an_axis_may_go_from_fine_to_coarse(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(ENTRY.replace("range: [1, 15]", "grid: [15, 11, 7, 3]")),
                         World(6, 3))  # fmt: skip
    assert found.setting == "level=7"


def test_an_edge_where_nothing_passes_is_unreachable(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(), World(20, 3))
    assert (found.state, found.setting) == ("unreachable", "")
    assert found.words.startswith("no setting passes: level=15")
    assert numbers(found.words) == [15.0, 0.5, 0.9, 4.0, 15.0]
    assert set(bench.levels("toss")) == {100}


def test_inconclusive_counts_as_failing(bench: SearchBench) -> None:
    world = World(6, 3)

    def scattered(cell: Cell) -> float:
        toss = cell.evaluator.name == "toss" and cell.codec.params["level"] < 9 and cell.repeat == 0
        return 0.0 if toss else world(cell)

    (found,) = bench.run(matrix(), scattered)
    assert found.setting == "level=9"
    assert "level=8 is inconclusive" in found.words
    assert "(caught 3/4 runs; " in found.words


def test_success_alone_is_bisected_too(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(evaluators="scales, {use: toss, params: {runs: 4}}"), World(6, 3))
    assert found.setting == "level=3"
    assert set(bench.levels("toss")) == {100, 8, 4, 2, 3}


def test_each_sequence_has_its_edge_and_what_is_found_is_measured_on_all(bench: SearchBench) -> None:
    text = matrix(
        evaluators="scales, {use: toss, params: {runs: 4}}, lag", sequences="flat, {use: flat, params: {gray: 3}}"
    )
    found = bench.run(text, World(0, 6))
    assert [(one.sequence, one.setting) for one in found] == [("flat0", "level=6"), ("flat3", "level=9")]
    both = {(cell.sequence.name, cell.codec.params["level"]) for cell in bench.computed if cell.evaluator.name == "lag"}
    assert both == {(name, level) for name in ("flat0", "flat3") for level in (100, 6, 9)}
    assert answers(open_run(bench.folder / "run", bench.registry)).sentence.startswith("Use dial level=9")


def test_a_matrix_that_judges_nothing_says_so(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(evaluators="scales, lag"), World(6, 3))
    assert found.words.startswith("stopped: no evaluator")


def test_what_there_is_no_time_for_is_not_tried_and_another_run_goes_on(
    bench: SearchBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.run(matrix(), World(6, 3), most_rounds=2)
    assert set(bench.levels("sight")) == {100, 8}
    monkeypatch.setattr(growth.Growth, "end_s", time.monotonic() - 1.0)
    (found,) = bench.run(matrix(), World(6, 3))
    assert (found.state, found.setting) == ("stopped", "")
    assert "no time left" in found.words
    assert numbers(found.words) == [1.0, 7.0, 1.0, 15.0]
    monkeypatch.setattr(growth.Growth, "end_s", float("inf"))
    assert bench.run(matrix(), World(6, 3))[0].setting == "level=6"
    assert 8 not in bench.levels("sight")


def test_a_setting_of_which_only_a_part_was_measured_is_not_known_to_pass(bench: SearchBench) -> None:
    bench.run(matrix(), World(6, 3), most_rounds=5)
    assert set(bench.levels("toss")) == {100}
    told = answers(open_run(bench.folder / "run", bench.registry)).sentence
    assert told.startswith("Nothing passes here")
    assert "level=5 (seen 0.5, ≥ 0.9 required)" in told
