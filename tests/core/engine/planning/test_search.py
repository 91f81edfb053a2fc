"""What a search may ask for, and what is said where it asks for what cannot be."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from search_bench import SearchBench, registry_of_searches

from codecbench.core.contracts.errors import MatrixError
from codecbench.core.engine.planning import search_section
from codecbench.core.engine.planning.model import SearchFinding, plan_from_json
from codecbench.core.engine.planning.plan import make_plan, make_sampled_plan
from codecbench.core.engine.planning.schema import matrix_schema

DIAL = "{use: dial, params: {level: {range: [0, 9]}}, %s}"


def text(*codecs: str, evaluators: str = "scales, toss", run: str = "workers: 1") -> str:
    return f"""
version: 1
sequences: [flat]
codecs: [{", ".join(codecs)}]
evaluators: [{evaluators}]
run: {{{run}}}
"""


@pytest.fixture
def bench(tmp_path: Path) -> SearchBench:
    return SearchBench(tmp_path)


def problems(bench: SearchBench, matrix: str) -> str:
    with pytest.raises(MatrixError) as caught:
        bench.matrix(matrix)
    return str(caught.value)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("search: {metric: wieght_bytes, min: 1}", "codecs[0].search.metric: no evaluator"),
        ("search: {metric: wieght_bytes, min: 1}", "'weight_bytes'? there are weight_bytes, caught"),
        ("at: {weight_bytes.p95: 1}", "codecs[0].at.metric: weight_bytes has no aggregate p95; it has mean, max"),
        ("at: {nothing: 1}", "codecs[0].at.metric: no evaluator"),
        ("search: {metric: weight_bytes}", "codecs[0].search: needs one of min, max"),
        ("search: {metric: weight_bytes, min: 1, max: 2}", "got min and max"),
        ("search: {metric: weight_bytes, min: 1, budget: 0}", "search.budget: "),
        ("search: {metric: weight_bytes, min: .nan}", "codecs[0].search.min: "),
        ("search: {metric: weight_bytes, min: heavy}", "codecs[0].search.min: "),
        ("search: {metric: weight_bytes, equal: 3, within: -1}", "search.within: "),
        ("search: {metric: weight_bytes, least: 3}", "codecs[0].search.least: unknown; allowed: metric, min"),
        ("search: 3", "{metric: NAME, min: NUMBER}, or passes; got 3"),
        ("at: {weight_bytes: 3, caught: 1}", "codecs[0].at: must be a mapping"),
        ("at: 0.5", "{METRIC: NUMBER}; got 0.5"),
        ("search: passes", "add the codec raw"),
        ("search: fails", "codecs[0].search: must be a mapping"),
        ("at: {weight_bytes: 3}, search: {metric: weight_bytes, min: 3}", "codecs[0].at: is short for "),
    ],
)
def test_invalid_searches_are_reported_at_their_place(bench: SearchBench, entry: str, said: str) -> None:
    assert said in problems(bench, text(DIAL % entry))


def test_what_passes_is_sought_along_one_parameter(bench: SearchBench) -> None:
    entry = "{use: dial, params: {level: {range: [0, 9]}, share: {grid: [0, 1]}}, search: passes}"
    said = problems(bench, text("still", entry))
    assert "codecs[1].search: " in said
    assert "level and share" in said


def test_a_metric_of_several_evaluators_is_to_be_told_apart(bench: SearchBench) -> None:
    two = "{use: toss, params: {runs: {grid: [1, 5]}}}"
    said = problems(bench, text(DIAL % "search: {metric: caught, min: 1}", evaluators=two))
    assert "measure 'caught'" in said
    assert ", ".join(f"toss(runs={runs}).caught" for runs in (1, 5)) in said
    named = text(DIAL % "search: {metric: toss(runs=5).caught, min: 1}", evaluators=two)
    (found,) = bench.matrix(named).searches
    assert found.objective.evaluator.params["runs"] == 5


def test_a_name_may_say_stage_and_aggregate(bench: SearchBench) -> None:
    for name, aggregate, stage in (
        ("weight_bytes", "mean", ""),
        ("scales.weight_bytes", "mean", ""),
        ("weight_bytes.max", "max", ""),
        ("scales.weight_bytes.encode/dct.max", "max", "encode/dct"),
        ("weight_bytes.encode", "mean", "encode"),
    ):
        (found,) = bench.matrix(text(DIAL % f"search: {{metric: {name}, max: 20}}")).searches
        assert (found.objective.aggregate, found.objective.stage) == (aggregate, stage)


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ("level: {grid: [10, 90, 50]}", "params.level: a search"),
        ("level: {grid: [1, 2, 2]}", "params.level: a search"),
        ("effort: {grid: [low, high, low]}", "params.effort: a search"),
        ("level: 3", "`{range: [first, last, step]}`"),
        ("level: {range: [5, 5]}", "several values"),
        ("level: {range: [990, 1010]}", "to 1000; got 1001"),
    ],
)
def test_parameters_without_an_order_are_refused(bench: SearchBench, params: str, said: str) -> None:
    assert said in problems(bench, text(f"{{use: dial, params: {{{params}}}, at: {{weight_bytes: 3}}}}"))


def test_several_parameters_without_the_extra_say_what_mends_it(
    bench: SearchBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    entry = "{use: dial, params: {level: {range: [0, 9]}, share: {grid: [0, 1]}}, at: {weight_bytes: 3}}"
    monkeypatch.setattr(search_section, "find_spec", lambda name: None)
    said = "codecs[0].at: a search over several parameters needs optuna; run: pip install 'codecbench[search]'"
    assert said in problems(bench, text(entry))
    bench.matrix(text(DIAL % "at: {weight_bytes: 3}"))


def test_evaluators_and_sequences_have_nothing_to_search(bench: SearchBench) -> None:
    said = problems(bench, text("dial", evaluators="{use: scales, at: {weight_bytes: 3}}"))
    assert "evaluators[0].at: unknown" in said


def test_nothing_of_a_search_is_planned_before_it_asks(bench: SearchBench) -> None:
    matrix = bench.matrix(text("still", DIAL % "at: {weight_bytes: 3}"))
    plan = make_plan(matrix, bench.registry)
    assert {cell.codec.name for cell in plan.cells} == {"still"}
    assert [setting.label for setting in matrix.searches[0].settings] == [f"level={level}" for level in range(10)]


def test_a_search_counts_with_its_budget_where_cells_are_too_many(
    bench: SearchBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("codecbench.core.engine.planning.matrix._MOST_CELLS", 1000)
    wide = "{use: dial, params: {level: {range: [0, 1000]}}, %s}"
    bench.matrix(text(wide % "search: {metric: weight_bytes, equal: 3, budget: 5}"))
    many = [wide % f"search: {{metric: weight_bytes, equal: {n}, budget: 900}}" for n in range(6)]
    assert "cells; at most 1,000 " in problems(bench, text(*many))


@pytest.mark.parametrize(
    ("until", "said"),
    [
        ("{decided: weight_bytes}", "run.until.decided: weight_bytes is not a success metric"),
        ("{decided: cought}", "run.until.decided.metric: no evaluator"),
        ("{decided: caught}", "run.until.decided: evaluator toss has one repeat"),
        ("{decided: {metric: caught, equal: 1}}", "min or max"),
        ("{until: caught}", "run.until.until: unknown"),
        ("{}", "run.until.decided: Field required"),
    ],
)
def test_invalid_stopping_rules_are_reported_at_their_place(bench: SearchBench, until: str, said: str) -> None:
    assert said in problems(bench, text("dial", run=f"until: {until}"))


def test_any_metric_of_repeats_may_be_decided_with_a_limit(bench: SearchBench) -> None:
    several = "{use: toss, params: {runs: 9}}"
    matrix = bench.matrix(text("dial", evaluators=several, run="until: {decided: {metric: caught, max: 0.5}}"))
    assert str(matrix.until) == "caught ≤ 0.5"


def test_what_was_found_is_kept_with_the_plan(bench: SearchBench) -> None:
    plan = make_plan(bench.matrix(text("dial")), bench.registry)
    found = SearchFinding("flat0", "dial", "weight_bytes = 3", "nearest", "level=0", 10.0, 3, "level=0 gives\t10")
    body = json.loads(json.dumps({**plan.as_json(), "searches": [vars(found)]}))
    assert plan_from_json(body).searches[0].reached == 10.0
    assert plan_from_json(body).searches[0].words == "level=0 gives 10"
    del body["searches"]
    assert plan_from_json(body).searches == (), "plans of earlier versions have none"


def test_editors_know_searches() -> None:
    schema = matrix_schema(registry_of_searches())
    (dial,) = [item for item in schema["properties"]["codecs"]["items"]["anyOf"]
               if item.get("properties", {}).get("use") == {"const": "dial"}]  # fmt: skip
    assert {"search", "at"} <= set(dial["properties"])
    objective, word = dial["properties"]["search"]["anyOf"]
    assert {"metric", "min", "max", "equal", "within", "budget"} == set(objective["properties"])
    assert word == {"const": "passes"}
    used = json.dumps(schema)
    for name in ("UntilSection", "ObjectiveSection"):
        assert f"#/$defs/{name}" in used
        assert name in schema["$defs"]


def test_a_sampled_plan_has_every_plugin(bench: SearchBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("codecbench.core.engine.planning.plan.installed", lambda: bench.registry)
    plan = make_sampled_plan(bench.matrix(text("still", DIAL % "at: {weight_bytes: 3}")))
    assert {(cell.codec.name, cell.evaluator.name) for cell in plan.cells} == {
        (codec, evaluator) for codec in ("still", "dial") for evaluator in ("scales", "toss")
    }
