"""What a stranger's evaluator measured stays in every table where its comparison fails, and there is an end to it."""

from __future__ import annotations

import csv
import io
import json

import pytest
from distributions import install_source
from installed_command import TINY, Place, plain_place
from told import numbers

pytestmark = pytest.mark.thorough

COMPARERS = """
import os
import sys
import time

from codecbench import FrameEvaluator, Measurement, Metric, NoParams, PluginSpec, hookimpl


class Exits(FrameEvaluator[NoParams]):
    name = "exits"
    version = "1"
    params_type = NoParams
    metrics = (Metric("g", "1", "lower", "one"), Metric("ratio", "1", "lower", "to the baseline's"))

    def evaluate(self, coded):
        yield Measurement("g", 1.0)

    def compare(self, outcome, baseline):
        sys.exit("no")


class Leaves(Exits):
    name = "leaves"

    def compare(self, outcome, baseline):
        os._exit(3)


class Hangs(Exits):
    name = "hangs"

    def compare(self, outcome, baseline):
        time.sleep(3600)


class Millions(Exits):
    name = "millions"

    def evaluate(self, coded):
        for number in range(10**6):
            yield Measurement("g", 1.0, stage=f"encode/{number % 900}")

    def compare(self, outcome, baseline):
        return iter(())


@hookimpl
def codecbench_evaluators():
    return [PluginSpec(cls.name, f"comparers:{cls.__name__}", "measures") for cls in (Exits, Leaves, Hangs, Millions)]
"""
REASONS = {
    "exits": "SystemExit: no",
    "leaves": "its process exited with status 3",
    "hangs": "no answer",
}
CODECS = "[{use: jpeg, params: {quality: {grid: [20, 40, 60, 80]}}}]"
"""More cells than a plugin may take hosts down with, so that it is no longer asked when a second folder is read."""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """A finished run of each evaluator in `runs/NAME`, but for the one without end."""
    place = plain_place(tmp_path_factory.mktemp("comparers"))
    install_source(place.site, "comparers", "1", COMPARERS)
    for name in (*REASONS, "millions"):
        text = TINY.replace("tiny", name).replace("[shift]", CODECS).replace("[error]", f"[{name}]")
        (place.folder / f"{name}.yaml").write_text(text)
    for name in REASONS:
        done = place.call("run", f"{name}.yaml", "--quiet")
        assert done.status == 0, done.output
    return place


def printed(place: Place, *words: str) -> str:
    done = place.call(*words, CODECBENCH_PLUGIN_TIMEOUT_S="6")
    assert done.status == 0, done.output
    return done.stdout


def rows(place: Place, *words: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(printed(place, "table", *words, "--format", "csv"))))


@pytest.mark.parametrize("name", REASONS)
def test_what_was_measured_stays_where_the_comparison_fails(place: Place, name: str) -> None:
    tidy = rows(place, f"runs/{name}", "--tidy")
    assert [row["value"] for row in tidy if row["metric"] == "g"] == ["1.0"] * 16
    missing = [row for row in tidy if row["metric"] == "ratio"]
    assert [row["value"] for row in missing] == [""] * 4
    assert all(row["reason"].startswith("not compared: ") and REASONS[name] in row["reason"] for row in missing)
    wide = rows(place, f"runs/{name}")
    assert [(row[f"{name}.g.mean"], row[f"{name}.ratio.mean"]) for row in wide] == [("1.0", "")] * 4


@pytest.mark.parametrize("name", REASONS)
def test_a_run_is_the_same_as_itself_where_the_comparison_fails(place: Place, name: str) -> None:
    found = json.loads(printed(place, "compare", f"runs/{name}", f"runs/{name}", "--all", "--format", "json"))["rows"]
    assert [row["verdict"] for row in found] == ["same"] * 8
    assert [row["before"] for row in found if row["metric"] == "g"] == [1.0] * 4


def test_measurements_of_frames_end_with_a_reason(place: Place) -> None:
    done = place.call("run", "millions.yaml", "--quiet")
    assert done.status == 1
    (reason, *_) = [row["reason"] for row in rows(place, "runs/millions", "--tidy")]
    assert "millions of comparers 1: " in reason
    assert "frame 0: g: " in reason
    assert numbers(reason) == [1, 0, 4000, 1000, 4, 1_000_000]
