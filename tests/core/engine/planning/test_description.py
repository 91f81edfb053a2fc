"""What a plan is told of plugins: complete, as JSON types, and refused where a plugin breaks the contract."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import plain_plugins
import pytest
from distributions import install_source
from installed_command import Place

from codecbench import PluginError, Unsupported
from codecbench.core.engine.planning.description import InvalidParams, describe, describe_sequence, description_fields
from codecbench.core.engine.plugins.registry import Registry

EXECUTOR = """
{top}
import os, sys, time
from codecbench import Executor, NoParams, PluginSpec, hookimpl

class Odd(Executor[NoParams]):
    name, version, params_type = "odd", "1", NoParams
    def __init__(self, params):
        {construct}
    def start(self, workers, prepare): ...
    def submit(self, task): ...
    def next_finished(self, timeout_s): ...
    def stop(self): ...
"""
HOOK = """
from codecbench import PluginSpec, hookimpl

@hookimpl
def codecbench_executors():
    return [PluginSpec("odd", "odd_executor:Odd", "an executor")]
"""
MATRIX = """
version: 1
sequences: [{use: synthetic, params: {stop: 2}}]
codecs: [raw]
evaluators: [quality]
run: {executor: odd}
"""


@pytest.fixture
def registry() -> Registry:
    ours = EntryPoint("executors", "codecbench.plugins.executors", "codecbench")
    return Registry([EntryPoint("plain", "plain_plugins", "codecbench"), ours])


def test_a_description_is_made_of_json_types(registry: Registry) -> None:
    for kind, name, values in (("codec", "shift", {"bits": 3}), ("evaluator", "error", {}), ("executor", "local", {})):
        told = description_fields(registry, kind, name, values, None)  # type: ignore[arg-type]
        assert json.loads(json.dumps(told)) == told


def test_parameters_are_complete_and_those_at_their_default_are_in_no_identity(registry: Registry) -> None:
    given, usual = (describe(registry, "codec", "shift", values) for values in ({"bits": 3}, {}))
    assert given.params["bits"] == 3
    assert given.params.keys() == usual.params.keys()
    assert given.explicit == ["bits"]
    assert given.identities == [{"bits": 3}]
    assert usual.identities == [{}]
    assert given.version == plain_plugins.Shift.version


def test_each_repeat_has_an_identity(registry: Registry) -> None:
    told = describe(registry, "evaluator", "stopwatch", {})
    evaluator = registry.create("evaluator", "stopwatch", {})
    assert len(told.identities) == evaluator.repeats
    assert (told.exclusive, told.runs_codec) == (evaluator.exclusive, True)


def test_invalid_parameters_are_told_with_the_names_that_are_known(registry: Registry) -> None:
    with pytest.raises(InvalidParams) as found:
        describe(registry, "codec", "shift", {"bits": "many", "color": 1})
    assert {detail["loc"][0] for detail in found.value.details} == {"bits", "color"}
    assert "bits" in found.value.fields
    json.dumps(found.value.details)


def test_what_is_missing_is_told_and_not_raised_where_the_class_is_there(
    registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(self: Any, params: Any) -> None:
        raise Unsupported("needs a library")

    monkeypatch.setattr(plain_plugins.Shift, "__init__", absent)
    assert describe(registry, "codec", "shift", {}).missing == "needs a library"


@pytest.mark.parametrize("repeats", [0, -1, 100_001])
def test_a_number_of_repeats_that_cannot_be_is_refused(
    registry: Registry, monkeypatch: pytest.MonkeyPatch, repeats: int
) -> None:
    monkeypatch.setattr(plain_plugins.ErrorEvaluator, "repeats", repeats, raising=False)
    with pytest.raises(PluginError, match=f"repeats is {repeats}; "):
        describe(registry, "evaluator", "error", {})


def test_a_version_that_is_no_string_is_refused(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plain_plugins.Shift, "version", 2)
    with pytest.raises(PluginError, match="version is 2; "):
        describe(registry, "codec", "shift", {})


def test_a_sequence_is_told_by_what_it_is(registry: Registry) -> None:
    told = describe_sequence(registry, "ramp", {"frames": 9})
    assert told["frames"] == 9
    assert json.loads(json.dumps(told)) == told


def test_what_a_sequence_notes_is_told_as_plain_text(registry: Registry, monkeypatch: pytest.MonkeyPatch) -> None:
    assert describe_sequence(registry, "ramp", {"frames": 9})["notes"] == []
    monkeypatch.setattr(plain_plugins.RampSequence, "notes", ("cut\x1b[2J short", *["again"] * 30))
    told = describe_sequence(registry, "ramp", {"frames": 9})["notes"]
    assert told[0] == "cut\\x1b[2J short"
    assert len(told) == 20


@pytest.mark.parametrize("notes", ["text", ["a list"], (1,)])
def test_notes_that_are_no_sentences_are_refused(
    registry: Registry, monkeypatch: pytest.MonkeyPatch, notes: object
) -> None:
    monkeypatch.setattr(plain_plugins.RampSequence, "notes", notes)
    with pytest.raises(PluginError, match=rf"RampSequence\.notes is {type(notes).__name__}; "):
        describe_sequence(registry, "ramp", {"frames": 9})


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("top", "construct", "said"),
    [
        ("import sys; sys.exit(0)", "pass", "SystemExit: 0"),
        ("import os; os._exit(0)", "pass", "exited with status 0"),
        ("import time; time.sleep(3600)", "pass", "within 4 s"),
        ("", "raise RuntimeError('not today')", "RuntimeError: not today"),
        ("", "os._exit(5)", "exited with status 5"),
    ],
    ids=["exits", "leaves", "hangs", "raises", "leaves when constructed"],
)
def test_an_executor_is_tried_in_a_host_first(tmp_path: Path, top: str, construct: str, said: str) -> None:
    place = Place(tmp_path)
    install_source(place.site, "odd-distribution", "1", HOOK)
    (place.site / "odd_executor.py").write_text(EXECUTOR.format(top=top, construct=construct))
    (tmp_path / "m.yaml").write_text(MATRIX)
    done = place.call("run", "m.yaml", CODECBENCH_PLUGIN_TIMEOUT_S="4")
    assert done.status == 2, done.output
    assert "m.yaml:6:" in done.stderr
    for fact in ("executor odd", "odd-distribution 1", said):
        assert fact in done.stderr
    assert "Traceback" not in done.output
