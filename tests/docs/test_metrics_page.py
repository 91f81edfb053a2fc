"""docs/metrics.md defines every metric that is declared, with label, unit, direction and role, and no other."""

from __future__ import annotations

import re
from dataclasses import dataclass

import pytest
from project import DOCS

from codecbench.core.contracts.evaluator import Evaluator
from codecbench.core.simulation.settings import LinkSettings, ReaderSettings
from codecbench.plugins.evaluators import codecbench_evaluators
from codecbench.plugins.evaluators.delivery import DeliveryEvaluator
from codecbench.plugins.evaluators.depth import DepthEvaluator
from codecbench.plugins.evaluators.features import Features
from codecbench.plugins.evaluators.localization import Localization
from codecbench.plugins.evaluators.operations import Operations
from codecbench.plugins.evaluators.place_recognition import PlaceRecognition
from codecbench.plugins.evaluators.quality import Quality
from codecbench.plugins.evaluators.relative_pose import RelativePose
from codecbench.plugins.evaluators.stream import Stream
from codecbench.plugins.evaluators.timing import Timing
from codecbench.plugins.evaluators.trajectory import TrajectoryEvaluator, files

PAGE = (DOCS / "metrics.md").read_text()
SECTIONS = {part.split("\n", 1)[0].strip(): part for part in re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:]}
EVALUATORS = (
    Quality, DepthEvaluator, Features, Localization, RelativePose, PlaceRecognition, Stream, DeliveryEvaluator, Timing,
    Operations, TrajectoryEvaluator,
)  # fmt: skip
ARROWS = {"↑": "higher", "↓": "lower", "": "neither"}
each = pytest.mark.parametrize("evaluator", EVALUATORS, ids=lambda evaluator: evaluator.name)


@dataclass(frozen=True)
class Row:
    """A row of the page: the metrics that share it, their labels and what it says of them all."""

    names: tuple[str, ...]
    headlines: tuple[str, ...]
    labels: tuple[str, ...]
    unit: str
    better: str
    role: str
    definition: str


def rows(evaluator: type[Evaluator]) -> list[Row]:
    """Where a row leaves it out: the role of the table's head, and the unit 1."""
    found, common = [], ""
    for line in SECTIONS[evaluator.name].splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if cells[:3] == ["metric", "label", "unit"]:
            common = "".join(re.findall(r"^definition \(role `(\w+)`\)$", cells[3]))
            assert common or cells[3:] == ["role", "definition"]
        elif re.match(r"\**`\w+`", cells[0]) and len(cells) == (4 if common else 5):
            names = tuple(re.findall(r"`(\w+)`", cells[0]))
            arrow = cells[2][-1:] if cells[2][-1:] in ARROWS else ""
            unit = cells[2].removesuffix(arrow).strip() or "1"
            first, *ends = cells[1].split("; ")
            stem = "".join(first.rpartition(", ")[:2])
            labels = (first, *(f"{stem}{end}" for end in ends))
            role = common or cells[3]
            headlines = tuple(re.findall(r"\*\*`(\w+)`\*\*", cells[0]))
            found.append(Row(names, headlines, labels, unit, ARROWS[arrow], role, cells[-1]))
    return found


@each
def test_every_metric_is_defined_and_no_other(evaluator: type[Evaluator]) -> None:
    named = [name for row in rows(evaluator) for name in row.names]
    assert sorted(named) == sorted(metric.name for metric in evaluator.metrics)
    assert all(len(row.definition) > 8 for row in rows(evaluator))


@each
def test_every_row_says_what_its_metrics_declare(evaluator: type[Evaluator]) -> None:
    """Metrics that share a row differ in labels, and in the ends of summaries."""
    declared = {metric.name: metric for metric in evaluator.metrics}
    for row in rows(evaluator):
        metrics = [declared[name] for name in row.names]
        assert {(metric.unit, metric.better) for metric in metrics} == {(row.unit, row.better)}, row.names
        assert tuple(metric.label for metric in metrics) == row.labels
        assert {metric.role for metric in metrics} == {row.role}, row.names
        assert tuple(metric.name for metric in metrics if metric.headline) == row.headlines
        if len(metrics) == 1:
            assert metrics[0].summary == row.definition, row.names
            continue
        for metric in metrics:
            ending = metric.summary.removeprefix(row.definition)
            family = metric.name.partition("_")[0]
            assert ending in ("", f", {metric.label.rpartition(', ')[2]}", f", {family} counts")


@pytest.mark.parametrize("evaluator", EVALUATORS[1:], ids=lambda evaluator: evaluator.name)
def test_every_parameter_is_named(evaluator: type[Evaluator]) -> None:
    """Those of a link stand in a table of the page of links, which the section leads to."""
    own, section = set(evaluator.params_type.model_fields), SECTIONS[evaluator.name]
    if issubclass(evaluator.params_type, LinkSettings):
        assert "#the-parameters)" in section
        table = "".join(re.findall(r"^\| `.*", (DOCS / "link.md").read_text(), re.MULTILINE))
        shared = own & ReaderSettings.model_fields.keys()
        assert shared
        assert [name for name in shared if f"`{name}`" not in table] == []
        own -= shared
    assert [name for name in own if f"`{name}`" not in section] == []


def test_every_file_is_named() -> None:
    named = re.findall(r"^\| `([\w.]+\.(?:txt|csv|ply))` \|", SECTIONS["trajectory"], re.MULTILINE)
    assert set(named) == {value for name, value in vars(files).items() if name.isupper() and isinstance(value, str)}


def test_every_evaluator_that_is_offered_is_on_the_page() -> None:
    specs = {spec.name: spec for spec in codecbench_evaluators()}
    assert set(specs) == {evaluator.name for evaluator in EVALUATORS}
    for evaluator in EVALUATORS:
        module, _, name = specs[evaluator.name].target.partition(":")
        assert evaluator.__name__ == name
        assert evaluator.__module__.startswith(module)


@each
def test_labels_tell_metrics_apart(evaluator: type[Evaluator]) -> None:
    labels = [metric.label for metric in evaluator.metrics]
    assert len(set(labels)) == len(labels)


def test_headlines_have_heads_of_their_own() -> None:
    heads = [metric.column_header for evaluator in EVALUATORS for metric in evaluator.metrics if metric.headline]
    assert len(set(heads)) == len(heads)
    assert max(len(line) for head in heads for line in head.splitlines()) <= 12
