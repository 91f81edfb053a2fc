"""Searches against settings of known size and known chances: what is found, what is computed, what is said."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from search_bench import SearchBench, size_of
from search_plugins import TossParams, chance
from told import numbers

from codecbench.core.engine.planning.model import Cell
from codecbench.core.engine.planning.plan import make_plan

ENTRY = "{use: dial, params: {level: {range: [0, 200]}}, %s}"


def matrix(
    *entries: str, evaluators: str = "scales", sequences: str = "flat", run: str = "workers: 1", fixed: str = ""
) -> str:
    return f"""
version: 1
name: sought
sequences: [{sequences}]
codecs: [{", ".join([*([fixed] if fixed else []), *entries])}]
evaluators: [{evaluators}]
run: {{{run}}}
"""


TOSS = "scales, {use: toss, params: {runs: 40, even_at_bytes: 301, steep: 0.05}}"


def weigh(cell: Cell) -> float:
    return size_of(cell) + cell.sequence.dataset.params["gray"]


def toss(cell: Cell) -> float:
    if cell.evaluator.name == "scales":
        return weigh(cell)
    rng = np.random.default_rng(cell.seed)
    return float(rng.random() < chance(size_of(cell), TossParams(**cell.evaluator.params)))


@pytest.fixture
def bench(tmp_path: Path) -> SearchBench:
    return SearchBench(tmp_path)


@pytest.mark.parametrize(
    "target", [10, 333, *(pytest.param(size, marks=pytest.mark.thorough) for size in (11, 100, 609, 610))]
)
def test_at_finds_the_nearest_size_there_is(bench: SearchBench, target: int) -> None:
    (found,) = bench.run(matrix(ENTRY % f"at: {{weight_bytes: {target}}}"), weigh)
    nearest = min(range(201), key=lambda level: abs(math.log(10 + 3 * level) - math.log(target)))
    assert found.setting == f"level={nearest}"
    assert found.reached == 10 + 3 * nearest
    assert found.state == ("found" if found.reached == target else "nearest")
    assert len(bench.computed) == found.trials <= 2 + math.ceil(math.log2(201))
    assert f"gives {found.reached:.4g}" in found.words


def test_at_gives_every_codec_and_sequence_its_own_setting_at_the_same_rate(bench: SearchBench) -> None:
    two = "flat, {use: flat, params: {gray: 90}}"
    costly = "{use: dial, params: {level: {range: [0, 200]}, share: 1.0}, at: {weight_bytes: 310}}"
    found = bench.run(matrix(ENTRY % "at: {weight_bytes: 310}", costly, sequences=two), weigh)
    assert [(one.sequence, one.setting, one.reached) for one in found] == [
        ("flat0", "level=100", 310.0),
        ("flat90", "level=70", 310.0),
        ("flat0", "level=67 share=1", 311.0),
        ("flat90", "level=37 share=1", 311.0),
    ]


def test_at_does_not_pretend_to_reach_what_no_setting_reaches(bench: SearchBench) -> None:
    low, high = bench.run(matrix(ENTRY % "at: {weight_bytes: 2}", ENTRY % "at: {weight_bytes: 5000}"), weigh)
    assert (low.state, low.setting, low.reached) == ("unreachable", "level=0", 10.0)
    assert (high.state, high.setting, high.reached) == ("unreachable", "level=200", 610.0)
    assert low.words.startswith("no setting reaches")
    assert "level=0 gives 10, +4e+02 %" in low.words


def test_near_enough_ends_a_search(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(ENTRY % "search: {metric: weight_bytes, equal: 300, within: 30}"), weigh)
    assert (found.state, found.setting, found.trials) == ("found", "level=100", 3)


@pytest.mark.parametrize(("bound", "level"), [("min", 97), ("max", 96)])
def test_a_limit_is_the_last_setting_that_will_do(bench: SearchBench, bound: str, level: int) -> None:
    (found,) = bench.run(matrix(ENTRY % f"search: {{metric: weight_bytes, {bound}: 300}}"), weigh)
    assert (found.state, found.setting) == ("found", f"level={level}")
    assert "meets the objective" in found.words
    assert "does not" in found.words


def test_falling_lists_and_words_are_orders_too(bench: SearchBench) -> None:
    falling = "{use: dial, params: {level: {grid: [90, 50, 20, 3]}}, at: {weight_bytes: 75}}"
    words = "{use: dial, params: {effort: {grid: [low, middle, high]}}, at: {scales.weight_bytes.max: 15}}"
    first, second = bench.run(matrix(falling, words), weigh)
    assert (first.setting, first.reached) == ("level=20", 70.0)
    assert (second.setting, second.reached) == ("effort=middle", 15.0)


def test_only_what_a_search_asks_about_is_tried_and_the_answer_by_all(bench: SearchBench) -> None:
    text = matrix(ENTRY % "at: {weight_bytes: 310}", evaluators="scales, {use: toss, params: {runs: 3}}", fixed="still")
    bench.run(text, toss)
    assert [sorted({cell.evaluator.name for cell in cells}) for cells in bench.rounds][-1] == ["toss"]
    assert [cell.codec.label for cell in bench.rounds[-1]] == ["level=100"] * 3
    assert len(bench.levels("scales")) == 1 + 3, "the baseline, both ends, and the middle, which is it"


def test_trials_are_the_cells_of_a_sweep(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(ENTRY % "at: {weight_bytes: 100}"), weigh)
    sweep = make_plan(bench.matrix(matrix("{use: dial, params: {level: {range: [0, 200]}}}")), bench.registry)
    assert {cell.id for cell in bench.computed} < {cell.id for cell in sweep.cells}
    bench.run(matrix("{use: dial, params: {level: {range: [0, 200]}}}"), weigh)
    assert len(bench.computed) == 201 - found.trials


@pytest.mark.thorough
def test_a_search_that_was_stopped_goes_on_and_computes_nothing_twice(bench: SearchBench) -> None:
    text = matrix(ENTRY % "at: {weight_bytes: 100}")
    whole = SearchBench(bench.folder / "whole")
    whole.folder.mkdir()
    expected = whole.run(text, weigh)
    seen: list[str] = []
    for _ in range(20):
        found = bench.run(text, weigh, most_rounds=1)
        seen += [cell.id for cell in bench.computed]
    assert found == expected
    assert sorted(seen) == sorted({cell.id for cell in whole.computed})
    assert bench.plan is not None
    assert bench.plan.searches == expected, "the plan of the folder says what was found"


def test_a_failed_trial_stops_the_search_and_the_next_run_goes_on(bench: SearchBench) -> None:
    text = matrix(ENTRY % "at: {weight_bytes: 100}", ENTRY % "at: {weight_bytes: 600}")
    broken = {50: "loose"}
    stopped, other = bench.run(text, lambda cell: broken.get(cell.codec.params["level"]) or weigh(cell))
    assert (stopped.state, stopped.setting, stopped.trials) == ("stopped", "", 3)
    assert "level=50 failed: loose" in stopped.words
    assert other.setting == "level=197", "another search goes on"
    mended, _ = bench.run(text, weigh)
    assert mended.setting == "level=30"
    assert bench.levels("scales")[0] == 50
    assert {0, 200, 100}.isdisjoint(bench.levels("scales"))


def test_values_that_are_no_numbers_stop_a_search(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(ENTRY % "at: {weight_bytes: 100}"), lambda cell: math.nan)
    assert (found.state, found.setting, found.reached) == ("stopped", "", None)
    assert "level=0 has no" in found.words
    (found,) = SearchBench(bench.folder).run(matrix(ENTRY % "search: {metric: weight_bytes, max: 5}"), weigh)
    (found,) = bench.run(matrix(ENTRY % "search: {metric: weight_bytes, min: 9}", run="seed: 5"), lambda _: math.nan)
    assert found.state == "unreachable"
    assert "nothing was weighed" in found.words
    assert numbers(found.words) == [3.0, 201.0]


def test_infinite_values_are_beyond_every_limit(bench: SearchBench) -> None:
    def weighed(cell: Cell) -> float:
        return math.inf if cell.codec.params["level"] > 150 else weigh(cell)

    (found,) = bench.run(matrix(ENTRY % "at: {weight_bytes: 455}"), weighed)
    assert (found.setting, found.reached) == ("level=148", 454.0)
    (found,) = bench.run(matrix(ENTRY % "at: {weight_bytes: 455}", run="seed: 1"), lambda _: math.inf)
    assert (found.state, found.setting) == ("unreachable", "")


def test_a_value_that_turns_is_told(bench: SearchBench) -> None:
    def humped(cell: Cell) -> float:
        return 300.0 - abs(cell.codec.params["level"] - 100)

    (found,) = bench.run(matrix(ENTRY % "at: {weight_bytes: 250}"), humped)
    assert found.setting == "level=50"
    assert "not monotone: 300" in found.words
    assert ": 300 at level=100" in found.words
    assert "not monotone" not in bench.run(matrix(ENTRY % "at: {weight_bytes: 250}", run="seed: 1"), weigh)[0].words


@pytest.mark.thorough
def test_a_value_that_turns_while_it_falls_is_told(bench: SearchBench) -> None:
    def bumped(cell: Cell) -> float:
        level = float(cell.codec.params["level"])
        return 600.0 - level + (200.0 if level == 100 else 0.0)

    (found,) = bench.run(matrix(ENTRY % "at: {weight_bytes: 450}"), bumped)
    assert "not monotone: 600" in found.words
    assert "600 at level=0, 700" in found.words
    assert "700 at level=100" in found.words
    falling = bench.run(matrix(ENTRY % "at: {weight_bytes: 450}", run="seed: 1"), lambda cell: 1000.0 - weigh(cell))
    assert "not monotone" not in falling[0].words


def test_a_spent_budget_is_reported(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(ENTRY % "search: {metric: weight_bytes, equal: 100, budget: 4}"), weigh)
    assert (found.state, found.trials, len(bench.computed)) == ("stopped", 4, 4)
    assert found.words.startswith("the budget is spent; ")
    (found,) = bench.run(matrix(ENTRY % "search: {metric: weight_bytes, min: 300, budget: 1}", run="seed: 1"), weigh)
    assert (found.state, found.setting) == ("stopped", "")


def test_where_every_setting_will_do_the_one_next_to_the_limit_is_taken(bench: SearchBench) -> None:
    (found,) = bench.run(matrix(ENTRY % "search: {metric: weight_bytes, max: 1000}"), weigh)
    assert (found.state, found.setting) == ("found", "level=200")
    assert "every setting tried" in found.words


@pytest.mark.thorough
def test_a_noisy_limit_is_found_with_confidence_and_few_runs(bench: SearchBench) -> None:
    text = matrix(ENTRY % "search: {metric: caught, min: 1}", evaluators=TOSS)
    (found,) = bench.run(text, toss)
    params = TossParams(runs=40, even_at_bytes=301, steep=0.05)
    level = int(found.setting.removeprefix("level="))
    assert chance(10 + 3 * level, params) > 0.5
    assert 97 <= level <= 140, "half of the runs are caught at 97; where 40 runs are sure of it is above that"
    tried = {}
    for cell in bench.computed:
        if cell.evaluator.name == "toss":
            tried[cell.codec.params["level"]] = max(tried.get(cell.codec.params["level"], 0), cell.repeat + 1)
    assert tried[0] == tried[200] == 8, "what is clear takes the fewest runs"
    assert tried[level] == 40, "and every evaluator looks at all repeats of the answer"
    assert sum(tried.values()) < 40 * len(tried)


def test_too_few_repeats_to_be_sure_count_as_the_table_shows_them(bench: SearchBench) -> None:
    three = TOSS.replace("runs: 40", "runs: 3").replace("steep: 0.05", "steep: 0")
    (found,) = bench.run(matrix(ENTRY % "search: {metric: caught, min: 1}", evaluators=three), toss)
    assert found.setting == "level=97"


def test_repeats_are_added_until_it_is_decided(bench: SearchBench) -> None:
    sweep = "{use: dial, params: {level: {grid: [0, 60, 90, 98, 110, 200]}}}"
    text = matrix(sweep, evaluators=TOSS, run="until: {decided: caught}", fixed="still")
    bench.run(text, toss)
    made = {}
    for cell in bench.computed:
        if cell.evaluator.name == "toss":
            made.setdefault((cell.codec.name, cell.codec.params["level"]), []).append(cell.repeat)
    counts = {key: len(repeats) for key, repeats in made.items()}
    assert all(sorted(repeats) == list(range(len(repeats))) for repeats in made.values())
    assert counts["still", 0] == 40, "others are judged beside the baseline, which is whole from the start"
    assert counts["dial", 200] == 8
    assert counts["dial", 98] > 8 or counts["dial", 90] > 8
    assert counts["dial", 0] == 8, "nothing depends on what lies below a setting that fails"
    assert bench.levels("toss")
    before = len(bench.computed)
    bench.run(text, toss)
    assert before > 0
    assert not bench.computed
    bench.run(matrix(sweep, evaluators=TOSS, fixed="still"), toss)
    assert len(bench.computed) == 7 * 40 - sum(counts.values()), "a run without `until` makes the rest"


def test_a_live_error_is_decided_of_each_setting(bench: SearchBench) -> None:
    """What is too large for a link fails, and says nothing of what is smaller."""

    def astray(cell: Cell) -> float:
        if cell.evaluator.name == "scales":
            return weigh(cell)
        return 9.0 if cell.codec.params["level"] == 200 else float(cell.repeat % 5 == 0)

    sweep = "{use: dial, params: {level: {grid: [0, 60, 200]}}}"
    evaluators, run = "scales, {use: stray, params: {runs: 40}}", "until: {decided: {metric: stray_m, max: 0.5}}"
    bench.run(matrix(sweep, evaluators=evaluators, run=run, fixed="{use: still, params: {level: 201}}"), astray)
    levels = bench.levels("stray")
    assert levels.count(200) == 8
    assert 8 < levels.count(201) < 40, "the baseline is one of them"
    assert levels.count(0) == levels.count(60) > 8


def test_runs_without_a_value_decide_nothing_and_are_not_repeated(bench: SearchBench) -> None:
    def nothing(cell: Cell) -> float:
        return weigh(cell) if cell.evaluator.name == "scales" else math.nan

    bench.run(matrix("{use: dial, params: {level: 5}}", evaluators=TOSS, run="until: {decided: caught}"), nothing)
    assert len(bench.levels("toss")) == 8


def test_an_answer_is_repeated_as_needed_too(bench: SearchBench) -> None:
    text = matrix(ENTRY % "at: {weight_bytes: 610}", evaluators=TOSS, run="until: {decided: toss.caught}")
    (found,) = bench.run(text, toss)
    assert (found.setting, len(bench.levels("toss"))) == ("level=200", 8)


@pytest.mark.thorough
def test_several_parameters_are_sampled_to_the_cheapest_that_will_do(bench: SearchBench) -> None:
    pytest.importorskip("optuna")
    entry = "{use: dial, params: {level: {range: [0, 30]}, share: {range: [0, 1, 0.05]}, effort: {grid: [low, high]}},"
    text = matrix(f"{entry} search: {{metric: weight_bytes, equal: 104, budget: 40, within: 1}}}}")
    (found,) = bench.run(text, weigh)
    assert found.reached is not None
    assert abs(found.reached - 104) <= 3
    assert found.trials <= 40
    again = SearchBench(bench.folder / "again")
    again.folder.mkdir()
    assert again.run(text, weigh) == (found,)
    caught = f"{entry} search: {{metric: caught, min: 1, budget: 60}}}}"
    sure = "scales, {use: toss, params: {even_at_bytes: 60}}"
    (cheapest,) = bench.run(matrix(caught, evaluators=sure), toss)
    assert cheapest.state == "found"
    assert "least weight_bytes" in cheapest.words
    spent = {cell.codec.label: size_of(cell) for cell in bench.computed}
    assert 60 <= spent[cheapest.setting] < 75


@pytest.mark.thorough
def test_rounds_of_a_search_never_take_back_what_was_planned(bench: SearchBench) -> None:
    planned: list[set[str]] = []
    for _ in range(6):
        bench.run(matrix(ENTRY % "at: {weight_bytes: 100}"), weigh, most_rounds=1)
        assert bench.plan is not None
        planned.append({cell.id for cell in bench.plan.cells})
    assert all(before <= after for before, after in pairwise(planned))
