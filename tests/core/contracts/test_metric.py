"""What metrics, views and evaluators may declare, and what they are told where they may not."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import codecbench
from codecbench import (
    Drawing,
    FrameTimeline,
    KeypointOverlay,
    Line,
    Metric,
    NoParams,
    SequenceEvaluator,
    TimelineRow,
    View,
)
from codecbench.core.analysis.collect import schema_of
from codecbench.core.contracts.errors import PluginError
from codecbench.core.contracts.metric import AGGREGATES
from codecbench.core.engine.planning.declared import codec_declaration, evaluator_declaration, read_declaration
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting, RunSettings, SequenceEntry, plan_from_json
from codecbench.core.engine.storage import aggregate
from codecbench.core.report.views import curve_styles


def test_a_metric_needs_no_more_than_its_first_four_fields() -> None:
    metric = Metric("drift_px", "px", "lower", "how far it drifts", ("median", "p95"), False)
    assert (metric.label, metric.column_header) == ("drift", "drift")
    assert (metric.role, metric.scale, metric.headline) == ("behaviour", "linear", False)
    assert not metric.repeatable
    assert Metric("db", "dB", "higher", "").label == "db"


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("better", "up", "'x': better is 'up'; .* higher, lower, neither"),
        ("role", "speed", "role is 'speed'; "),
        ("scale", "root", "'root'; .* linear, log$"),
        ("aggregates", ("mean", "mode"), "'mode'; .* mean, std"),
        ("aggregates", "mean", "aggregates is 'mean'; "),
        ("aggregates", (), r"aggregates is \(\); "),
    ],
)
def test_a_wrong_value_is_refused_where_it_stands(field: str, value: object, message: str) -> None:
    with pytest.raises(PluginError, match=message):
        Metric(**{"name": "x", "unit": "1", "better": "higher", "summary": "", field: value})  # type: ignore[arg-type]


def test_the_aggregates_that_may_be_named_are_those_that_are_computed() -> None:
    assert tuple(aggregate.AGGREGATES) == AGGREGATES


@pytest.mark.parametrize(
    ("kind", "metrics", "message"),
    [
        ("pie", ("x",), "kind is 'pie'"),
        ("curve", (), r"'Seen': .*\(\); .* 1 to 2$"),
        ("curve", ("x", "y", "z"), "'z'.* 1 to 2$"),
        ("map", ("x",), "map names 0$"),
        ("bars", "x", "metrics is 'x'; .* 1 to 100$"),
    ],
)
def test_a_wrong_view_is_refused(kind: str, metrics: tuple[str, ...], message: str) -> None:
    with pytest.raises(PluginError, match=message):
        View(kind, "Seen", metrics)  # type: ignore[arg-type]


def test_a_wrong_line_is_refused() -> None:
    with pytest.raises(PluginError, match=r"'red'; .* before, after$"):
        Line("path", "red", np.zeros((2, 2)))  # type: ignore[arg-type]
    with pytest.raises(PluginError, match=r"points .*\(2, 3\); .*\(N, 2\)"):
        Line("path", "truth", np.zeros((2, 3)))
    assert Drawing((Line("path", "truth", np.zeros((2, 2))),), "").holds is None


@pytest.mark.parametrize(
    ("metrics", "views", "message"),
    [
        (("x",), (View("curve", "Seen", ("y",)),), "'Seen' names 'y'; .* x$"),
        (("x", "x"), (), "declares x twice"),
    ],
)
def test_an_evaluator_that_names_what_it_does_not_declare_is_refused(
    metrics: tuple[str, ...], views: tuple[View, ...], message: str
) -> None:
    members = {"metrics": tuple(Metric(name, "1", "higher", "") for name in metrics), "views": views}
    with pytest.raises(PluginError, match=message):
        type("Wrong", (SequenceEvaluator,), members)


def test_a_witness_must_be_declared_too() -> None:
    wall = Metric("wall_ms", "ms", "lower", "", confirmed_by="cpu_ms")
    with pytest.raises(PluginError, match=r"Wrong: .*'wall_ms' names 'cpu_ms'; "):
        type("Wrong", (SequenceEvaluator,), {"metrics": (wall,)})


class Grain(SequenceEvaluator[NoParams]):
    name = "grain"
    version = "1"
    params_type = NoParams
    metrics = (Metric("grain_db", "dB", "lower", "how coarse", ("median",), role="task", headline=True, scale="log"),)
    views = (View("curve", "Rate and grain", ("grain_db",)), View("map", "Grains"))
    typical_ms_per_frame = 7.0

    def evaluate(self, coded, context):  # type: ignore[no-untyped-def]
        return iter(())


def plan_with(meaning: dict[str, object]) -> Plan:
    sequence = SequenceEntry("s", PluginSetting("dataset", "d", "1"), "f00d", 1, 1, False, False)
    codec, evaluator = PluginSetting("codec", "plain", "1"), PluginSetting("evaluator", "grain", "1", {}, "size=2")
    cell = Cell("c", sequence, codec, evaluator, 0, 0, False, None)
    run = RunSettings(1, 1.0, 1, 0, PluginSetting("executor", "here", "1"))
    return Plan("n", "", run, (sequence,), (), (cell,), meaning)


def test_meaning_travels_with_the_plan() -> None:
    codec = SimpleNamespace(name="plain", reference="anchor", stateless=True)
    meant = {
        "codecs": {codec.name: codec_declaration(codec)},
        "evaluators": {"grain(size=2)": evaluator_declaration(Grain.create())},
    }
    plan = plan_from_json(json.loads(json.dumps(plan_with(meant).as_json())))
    meaning = schema_of(plan, {})
    assert meaning.metrics == {"grain(size=2)": {"grain_db": Grain.metrics[0]}}
    assert meaning.views == {"grain(size=2)": Grain.views}
    assert (meaning.anchors, meaning.baselines, meaning.stateless) == (("plain",), frozenset(), {"plain": True})
    assert meant["evaluators"]["grain(size=2)"]["typical_ms_per_frame"] == 7.0
    assert meant["evaluators"]["grain(size=2)"]["offers"] == []


def test_a_plan_of_an_earlier_version_takes_its_meaning_from_what_is_installed() -> None:
    stored = plan_with({}).as_json()
    del stored["declared"]
    plan = plan_from_json(stored)
    meaning = schema_of(plan, {"grain(size=2)": Grain.create()})
    assert meaning.metrics == {"grain(size=2)": {"grain_db": Grain.metrics[0]}}
    assert meaning.views == {"grain(size=2)": Grain.views}


def test_what_a_later_version_stored_and_this_one_cannot_read_falls_back() -> None:
    meant = {"codecs": {}, "evaluators": {"grain(size=2)": evaluator_declaration(Grain.create())}}
    meant["evaluators"]["grain(size=2)"]["metrics"][0] |= {"role": "mood", "aura": 1}
    meaning = schema_of(plan_with(meant), {"grain(size=2)": Grain.create()})
    assert meaning.metrics["grain(size=2)"]["grain_db"] == Grain.metrics[0]


def test_curves_are_told_apart_and_baselines_are_neutral() -> None:
    names = ["raw", *(f"codec{number} level=1" for number in range(20))]
    styles = curve_styles(names, {"raw"})
    assert len({(style.color, style.marker) for style in styles.values()}) == 21
    assert len({(style.color, style.symbol) for style in styles.values()}) == 21
    assert styles["raw"].color not in {styles[name].color for name in names[1:]}


def test_curves_of_a_codec_share_its_color_and_24_are_told_apart() -> None:
    names = [f"codec{number} level={level}" for number in range(12) for level in (1, 2)]
    styles = curve_styles(names, set())
    assert len({(style.color, style.symbol) for style in styles.values()}) == 24
    assert all(styles[f"codec{n} level=1"].color == styles[f"codec{n} level=2"].color for n in range(12))
    assert all(styles[f"codec{n} level=1"].dashes != styles[f"codec{n} level=2"].dashes for n in range(12))


def test_the_color_of_a_codec_is_that_of_its_name_alone() -> None:
    compared = {
        "jpeg": "#D55E00", "h264": "#0072B2", "jpeg2000": "#009E73", "multilevel": "#E69F00", "avif": "#CC79A7",
        "hevc": "#7F3B08", "av1": "#994F00", "webp": "#1A85FF", "jpegxl": "#56B4E9", "htj2k": "#005F6B",
        "orb_features": "#5D3A9B",
    }  # fmt: skip
    assert len(set(compared.values())) == 11
    for order in (list(compared), list(reversed(compared)), ["codec7", *compared]):
        styles = curve_styles(order, {"raw"})
        assert {name: styles[name].color for name in compared} == compared
    assert curve_styles(["mine qf=5"], set())["mine qf=5"].color == curve_styles(["mine"], set())["mine"].color


def test_codecs_that_share_a_color_differ_in_dashes_and_markers() -> None:
    features, ours = curve_styles(["orb_features", "jpeg_qf"], set()).values()
    assert features.color == ours.color
    assert features.dashes != ours.dashes
    assert features.marker != ours.marker


@pytest.mark.parametrize(
    "values", [(np.zeros((3, 2)), np.zeros(2)), (np.zeros((2, 3)), np.zeros(2)), (np.full((2, 2), np.inf), np.zeros(2))]
)
def test_a_timeline_has_a_place_and_an_error_for_each_frame(values: tuple[np.ndarray, np.ndarray]) -> None:
    with pytest.raises(PluginError, match="timeline: "):
        FrameTimeline(np.arange(2), *values, "m")


@pytest.mark.parametrize(
    ("tone", "holds", "words"),
    [("bad", np.zeros(3, bool), "'gone' .*3 frames; .* 2$"), ("poor", np.zeros(2, bool), "'poor'; .* good, fair"),
     ("bad", np.zeros(2), r"float64; .*\(N,\) of bool")],
)  # fmt: skip
def test_a_lane_says_of_each_frame_whether_it_holds(tone: Any, holds: np.ndarray, words: str) -> None:
    with pytest.raises(PluginError, match=words):
        FrameTimeline(np.arange(2), None, np.zeros(2), "m", (TimelineRow("gone", tone, holds),))


def test_marks_have_a_verdict_for_each_place() -> None:
    with pytest.raises(PluginError, match=r"\(N, 2\) and \(N,\)"):
        KeypointOverlay(np.zeros((3, 2)), np.zeros(2, bool), "two of three")


@pytest.mark.parametrize("axes", [("time",), "time", ("a", "b", "c")])
def test_a_drawing_names_both_axes_or_none(axes: object) -> None:
    with pytest.raises(PluginError, match="both axes"):
        Drawing((), "it", None, axes)  # type: ignore[arg-type]


def test_the_axes_of_a_plane_have_the_unit_of_its_timeline() -> None:
    positions, errors = np.zeros((2, 2)), np.zeros(2)
    assert Drawing((), "a map", timeline=FrameTimeline(np.arange(2), positions, errors, "m")).labels == (
        "x [m]",
        "y [m]",
    )
    assert Drawing((), "a map").labels == ("x", "y")
    assert Drawing((), "ages", axes=("time [s]", "age [s]")).labels == ("time [s]", "age [s]")


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_former_names_still_work() -> None:
    metric = Metric("age_s", "s", "lower", "", need="delay", brief="age")
    assert metric == Metric("age_s", "s", "lower", "", quantity="delay", column_header="age")
    assert (metric.need, metric.brief) == ("delay", "age")
    stored = {"name": "age_s", "unit": "s", "better": "lower", "summary": "", "need": "delay"}
    assert read_declaration(Metric, stored).quantity == "delay"
    rows = (codecbench.Lane("late", "bad", np.zeros(1, bool)),)
    timeline = codecbench.Course(np.arange(1), None, np.zeros(1), "s", lanes=rows)
    assert Drawing((), "ages", course=timeline).timeline.rows == rows


def test_a_former_name_says_the_current_one() -> None:
    with pytest.warns(DeprecationWarning, match=r"^Metric\.need .* quantity$"):
        Metric("age_s", "s", "lower", "", need="delay")
