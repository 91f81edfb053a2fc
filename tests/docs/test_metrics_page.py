"""docs/metrics.md defines every metric that is declared, with its unit and direction, and no other."""

from __future__ import annotations

import re

import pytest
from project import DOCS

from codecbench.core.contracts.evaluator import Evaluator
from codecbench.plugins.evaluators import codecbench_evaluators
from codecbench.plugins.evaluators.features import Features
from codecbench.plugins.evaluators.quality import Quality
from codecbench.plugins.evaluators.trajectory import TrajectoryEvaluator, files

PAGE = (DOCS / "metrics.md").read_text()
SECTIONS = {part.split("\n", 1)[0].strip(): part for part in re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]}
EVALUATORS = (Quality, Features, TrajectoryEvaluator)


@pytest.mark.parametrize("evaluator", EVALUATORS, ids=lambda evaluator: evaluator.name)
def test_every_metric_is_defined_with_unit_and_direction(evaluator: type[Evaluator]) -> None:
    rows = re.findall(
        r"^\| `(\w+)` \| ([^|]+) \| (higher|lower|neither) \| .+ \|$", SECTIONS[evaluator.name], re.MULTILINE
    )
    assert rows == [(metric.name, metric.unit, metric.better) for metric in evaluator.metrics]


@pytest.mark.parametrize("evaluator", [Features, TrajectoryEvaluator], ids=lambda evaluator: evaluator.name)
def test_every_parameter_is_named(evaluator: type[Evaluator]) -> None:
    for name in evaluator.params_type.model_fields:
        assert f"`{name}`" in SECTIONS[evaluator.name]


def test_every_file_is_named() -> None:
    named = re.findall(r"^\| `([\w.]+\.(?:txt|csv|ply))` \|", SECTIONS["trajectory"], re.MULTILINE)
    assert set(named) == {value for name, value in vars(files).items() if name.isupper() and isinstance(value, str)}


def test_offers_lead_to_the_classes_that_they_name() -> None:
    specs = {spec.name: spec for spec in codecbench_evaluators()}
    for evaluator in EVALUATORS:
        module, _, name = specs[evaluator.name].target.partition(":")
        assert evaluator.__name__ == name
        assert evaluator.__module__.startswith(module)


@pytest.mark.parametrize("evaluator", EVALUATORS, ids=lambda evaluator: evaluator.name)
def test_aggregates_are_ones_that_tables_know(evaluator: type[Evaluator]) -> None:
    from codecbench.core.engine.aggregate import AGGREGATES

    for metric in evaluator.metrics:
        assert set(metric.aggregates) <= set(AGGREGATES)
