"""An evaluator that is asked elsewhere says what it would say here, and where it fails it says why."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import plain_plugins
import pytest

from codecbench import PluginError, Unsupported
from codecbench.core.analysis.hosted_evaluator import HostedEvaluator
from codecbench.core.contracts.evaluator import Measurement, Outcome
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import Drawing, FrameTimeline, Line, TimelineRow
from codecbench.core.engine.hosting.host import PluginFault
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.plugins.registry import Registry

SETTING = PluginSetting("evaluator", "error", "1")
BASELINE = [Outcome(0, (Measurement("error", 2.0),), Path("baseline"))]
OUTCOME = Outcome(1, (Measurement("error", math.inf, stage="all"),), Path("cell"))


class Elsewhere(Registry):
    """Asks as hosts do: arguments and answers are JSON texts on the way."""

    def ask(self, function: Callable[..., Any], *arguments: Any, of: Any, times: float = 1) -> Any:
        return json.loads(json.dumps(function(self, *json.loads(json.dumps(arguments)))))


@pytest.fixture
def evaluator(monkeypatch: pytest.MonkeyPatch) -> HostedEvaluator:
    metrics = (Metric("error", "1", "lower", "error"), Metric("ratio", "1", "lower", "error over the baseline's"))
    monkeypatch.setattr(plain_plugins.ErrorEvaluator, "metrics", metrics)
    return HostedEvaluator(
        Elsewhere([EntryPoint("plain", "plain_plugins", "codecbench")]), SETTING, ["compare", "drawing"]
    )


def answering(monkeypatch: pytest.MonkeyPatch, name: str, answer: Any) -> None:
    monkeypatch.setattr(plain_plugins.ErrorEvaluator, name, answer, raising=False)


def test_it_compares_as_the_plugin_does(evaluator: HostedEvaluator, monkeypatch: pytest.MonkeyPatch) -> None:
    def compare(self: Any, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        assert (outcome.repeat, outcome.measurements) == (OUTCOME.repeat, OUTCOME.measurements)
        assert outcome.artifacts == Path("cell").absolute()
        yield Measurement("ratio", outcome.measurements[0].value / baseline[0].measurements[0].value)

    answering(monkeypatch, "compare", compare)
    assert list(evaluator.compare(OUTCOME, BASELINE)) == [Measurement("ratio", math.inf)]


@pytest.mark.parametrize(
    ("yielded", "said"),
    [
        ([Measurement("speed", 1.0)], "'speed'.*: error, ratio"),
        (["fast"], "compare: yielded str"),
        ([Measurement("ratio", math.nan)], "compare: ratio: NaN"),
    ],
    ids=["undeclared", "no measurement", "no reason"],
)
def test_what_breaks_the_contract_is_said(
    evaluator: HostedEvaluator, monkeypatch: pytest.MonkeyPatch, yielded: list[Any], said: str
) -> None:
    answering(monkeypatch, "compare", lambda *_: yielded)
    with pytest.raises(PluginError, match=said):
        evaluator.compare(OUTCOME, BASELINE)


def test_a_host_that_ends_costs_what_it_has_and_is_not_asked_for_what_it_has_not(
    evaluator: HostedEvaluator, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone(*_: Any, **__: Any) -> None:
        raise PluginFault("status 3")

    monkeypatch.setattr(Elsewhere, "ask", gone)
    for asked in (lambda: evaluator.compare(OUTCOME, BASELINE), lambda: evaluator.drawing(OUTCOME)):
        with pytest.raises(PluginFault, match="status 3"):
            asked()
    bare = HostedEvaluator(evaluator._registry, SETTING, [])
    assert (list(bare.compare(OUTCOME, BASELINE)), bare.drawing(OUTCOME)) == ([], None)


def test_a_drawing_arrives_as_it_was_drawn(evaluator: HostedEvaluator, monkeypatch: pytest.MonkeyPatch) -> None:
    points = np.array([[0.0, 1.5], [2.0, -3.25]])
    drawn = Drawing((Line("path", "truth", points), Line("none", "after", np.empty((0, 2)))), "two points", False)
    answering(monkeypatch, "drawing", lambda *_: drawn)
    found = evaluator.drawing(OUTCOME)
    assert found is not None
    assert (found.caption, found.holds) == ("two points", False)
    assert [(line.name, line.stroke) for line in found.lines] == [("path", "truth"), ("none", "after")]
    assert np.array_equal(found.lines[0].points, points)
    assert found.lines[1].points.shape == (0, 2)
    answering(monkeypatch, "drawing", lambda *_: None)
    assert evaluator.drawing(OUTCOME) is None


def test_the_course_of_a_drawing_arrives_with_what_is_not_known(
    evaluator: HostedEvaluator, monkeypatch: pytest.MonkeyPatch
) -> None:
    positions, errors = np.array([[0.5, 1.0], [np.nan, np.nan]]), np.array([0.25, np.nan])
    rows = (TimelineRow("gone", "bad", np.array([False, True])),)
    timeline = FrameTimeline(np.array([3, 4]), positions, errors, "m", rows, "how far off")
    answering(monkeypatch, "drawing", lambda *_: Drawing((), "a path", timeline=timeline))
    found = evaluator.drawing(OUTCOME)
    assert found is not None
    assert found.timeline is not None
    assert found.timeline.frames.tolist() == [3, 4]
    assert np.array_equal(found.timeline.positions, positions, equal_nan=True)
    assert np.array_equal(found.timeline.errors, errors, equal_nan=True)
    assert (found.timeline.unit, found.timeline.quantity) == ("m", "how far off")
    ((name, tone, holds),) = [(row.name, row.tone, row.holds) for row in found.timeline.rows]
    assert (name, tone, holds.tolist(), holds.dtype) == ("gone", "bad", [False, True], np.dtype(bool))
    no_map = FrameTimeline(np.array([3, 4]), None, errors, "s")
    answering(monkeypatch, "drawing", lambda *_: Drawing((), "ages", timeline=no_map))
    again = evaluator.drawing(OUTCOME)
    assert again is not None
    assert again.timeline is not None
    assert again.timeline.positions is None


def test_one_that_is_missing_something_is_refused(evaluator: HostedEvaluator, monkeypatch: pytest.MonkeyPatch) -> None:
    def absent(self: Any, params: Any) -> None:
        raise Unsupported("needs a library")

    answering(monkeypatch, "__init__", absent)
    with pytest.raises(Unsupported, match="needs a library"):
        evaluator.compare(OUTCOME, BASELINE)
