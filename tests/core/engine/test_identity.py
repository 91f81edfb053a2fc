"""What makes a cell new, and what does not: plugins that change between two runs, each a command of its own."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Literal

import pytest
from distributions import register
from pydantic import Field
from warm_command import run_warm

from codecbench import Params
from codecbench.core.engine.identity import canonical_json, digest, seed_from
from codecbench.core.engine.planning.description import without_defaults

PLUGINS = """
from codecbench import (
    NULL_TRACE, Capabilities, Codec, Dataset, Frame, FrameEvaluator, Measurement, Metric, NoParams, Params, PluginSpec,
    FrameSequence, hookimpl,
)
import numpy as np


class Noise(FrameSequence):
    name, frame_rate_hz, channels, camera, ground_truth, fingerprint = "noise", 1.0, 1, None, None, "noise"
    timestamps_s = np.arange(3.0)

    def read(self, index):
        return Frame(index, float(index), np.random.default_rng(index).integers(0, 256, (8, 8), np.uint8))


class NoiseDataset(Dataset[NoParams]):
    name, version, params_type = "noise", "1", NoParams

    def open(self):
        return Noise()


class DropParams(Params):
    bits: int = 1


class Drop(Codec[DropParams]):
    name, version, params_type, capabilities = "drop", "1", DropParams, Capabilities(channels=(1,))

    def encode(self, image, *, trace=NULL_TRACE):
        return bytes([*image.shape, self.params.bits]) + (image >> self.params.bits).tobytes()

    def decode(self, bitstream, *, trace=NULL_TRACE):
        height, width, bits = bitstream[:3]
        return np.frombuffer(bitstream[3:], np.uint8).reshape(height, width) << bits


class Loss(FrameEvaluator[NoParams]):
    name, version, params_type = "loss", "1", NoParams
    metrics = (Metric("largest", "1", "lower", "largest difference"),)

    def evaluate(self, coded):
        difference = np.abs(coded.original.image.astype(int) - coded.decoded)
        yield Measurement("largest", float(difference.max()))


@hookimpl
def codecbench_datasets():
    return [PluginSpec("noise", "changing:NoiseDataset", "noise")]


@hookimpl
def codecbench_codecs():
    return [PluginSpec("drop", "changing:Drop", "drops bits")]


@hookimpl
def codecbench_evaluators():
    return [PluginSpec("loss", "changing:Loss", "what is lost")]
"""
MATRIX = """
version: 1
name: changing
sequences: [noise]
codecs: [drop, {use: drop, params: {bits: 4}}]
evaluators: [loss]
run: {workers: 1}
"""
GAINED = ("    bits: int = 1\n", "    bits: int = 1\n    rounding: bool = False\n")
CHANGED = ("    bits: int = 1\n", "    bits: int = 2\n")


class Place:
    """A folder with a matrix and plugins that a test edits between commands."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "site").mkdir()
        register(folder / "site", "changing", "1", "changing")
        (folder / "changing.yaml").write_text(MATRIX)
        self.module = folder / "site" / "changing.py"
        self.module.write_text(PLUGINS)

    def edit(self, old: str, new: str) -> None:
        source = self.module.read_text()
        assert old in source
        self.module.write_text(source.replace(old, new))

    def call(self, *words: str, status: int = 0) -> str:
        environment = {**os.environ, "PYTHONPATH": str(self.folder / "site"), "COLUMNS": "200"}
        environment["PYTHONDONTWRITEBYTECODE"] = "1"  # edits within a second would be missed
        done = run_warm(words, self.folder, environment, 120)
        assert done.returncode == status, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout + done.stderr

    def run(self, *options: str) -> tuple[int, int]:
        """How many cells are ok after a run, and how many of them are from before."""
        out = self.call("run", "changing.yaml", "--quiet", *options)
        kept = re.search(r", (\d+) of them", out)
        ok = re.search(r"cells: (\d+) ok", out)
        assert ok, out
        return int(ok[1]), int(kept[1]) if kept else 0

    def column(self, name: str) -> list[str]:
        lines = self.call("table", "runs/changing", "--format", "csv", "--columns", f"loss.{name}.*").splitlines()
        return [line.rsplit(",", 1)[1] for line in lines[1:]]

    def log(self) -> str:
        return (self.folder / "runs" / "changing" / "run.log").read_text()

    def bitstreams(self) -> int:
        return len(list((self.folder / "runs" / "changing" / "coded").glob("*.bits")))


@pytest.fixture
def place(tmp_path: Path) -> Place:
    return Place(tmp_path)


@pytest.mark.thorough
def test_a_codec_that_gains_a_parameter_keeps_its_cells_and_one_with_another_default_does_not(place: Place) -> None:
    assert place.run() == (2, 0)
    assert place.column("largest") == ["1.0", "15.0"]
    place.edit(*GAINED)
    assert place.run() == (2, 2)
    assert place.bitstreams() == 2, "nothing asked for bitstreams"
    place.edit(*CHANGED)
    assert re.search(r"again \(1\): codec drop: .*bits .* 1 .* 2\b", place.call("plan", "changing.yaml"))
    assert place.run() == (2, 1)
    assert re.search(r"\b1 record.* again: codec drop: .*bits .* 1 .* 2\b", place.log())
    assert place.column("largest") == ["3.0", "15.0"], "bitstreams of the old default are not used"
    assert place.run() == (2, 2)


@pytest.mark.thorough
def test_a_metric_that_an_evaluator_gains_is_missing_until_it_is_asked_for(place: Place) -> None:
    place.run()
    place.edit('"largest difference"),)', '"largest difference"), Metric("mean", "1", "lower", "mean difference"))')
    place.edit(
        '        yield Measurement("largest"',
        '        yield Measurement("mean", float(difference.mean()))\n        yield Measurement("largest"',
    )
    assert place.run() == (2, 2)
    assert place.column("mean") == ["", ""]
    tidy = place.call("table", "runs/changing", "--tidy", "--format", "csv")
    reason = "declared after this cell was measured; `codecbench run --recompute loss` measures it"
    assert tidy.count(reason) == 2
    assert place.run("--recompute", "loss") == (2, 0)
    assert reason not in place.call("table", "runs/changing", "--tidy", "--format", "csv")
    assert [float(value) > 0 for value in place.column("mean")] == [True, True]
    assert place.column("largest") == ["1.0", "15.0"]
    assert place.run() == (2, 2)


@pytest.mark.slow
def test_cells_are_computed_again_by_name(place: Place) -> None:
    place.run()
    coded = {path: path.stat().st_mtime_ns for path in (place.folder / "runs/changing/coded").glob("*.bits")}
    assert place.run("--recompute", "loss") == (2, 0)
    assert {path: path.stat().st_mtime_ns for path in coded} == coded, "an evaluator reads the same bitstreams"
    assert place.run("--recompute", "drop") == (2, 0)
    assert all(path.stat().st_mtime_ns != before for path, before in coded.items())
    assert place.run("--recompute", "noise", "--recompute", "drop") == (2, 0)
    out = place.call("run", "changing.yaml", "--recompute", "lost", status=2)
    assert re.search("called 'lost'; .*'loss'", out)
    assert "drop, loss, noise" in out
    assert place.run() == (2, 2), "a wrong name removes nothing"


class Inner(Params):
    depth: int = 1
    width: int = 1


class Outer(Params):
    inner: Inner = Inner()
    extra: dict[str, int] = Field(default_factory=dict)
    scale: float = 1.0


def told(params: Params) -> dict[str, object]:
    return without_defaults(params.identity(), params)


def test_parameters_at_their_default_are_left_out_in_nested_models_too() -> None:
    assert told(Outer()) == {}
    assert told(Outer(inner=Inner(depth=2))) == {"inner": {"depth": 2}}
    assert told(Outer(scale=2, extra={"a": 1})) == {"scale": 2.0, "extra": {"a": 1}}


def test_what_a_plugin_tells_otherwise_stays() -> None:
    params = Outer(scale=2)
    assert without_defaults({"scale": 3, "repeat": 0, "inner": params.identity()["inner"]}, params) == {
        "scale": 3,
        "repeat": 0,
    }


class Left(Params):
    kind: Literal["left"] = "left"


class Right(Params):
    kind: Literal["right"] = "right"


class Either(Params):
    side: Left | Right = Left()


def test_settings_that_only_a_default_tells_apart_stay_apart() -> None:
    assert told(Either()) == {}
    assert told(Either(side=Right())) == {"side": {"kind": "right"}}


def test_one_spelling_of_json_one_digest() -> None:
    assert canonical_json({"b": [1, 2.5, None], "a": "é"}) == b'{"a":"\\u00e9","b":[1,2.5,null]}'
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1}) == "b48465408132d0bff24c5d5f94bfe758"
    with pytest.raises(ValueError, match="not JSON compliant"):
        digest(float("nan"))
    assert seed_from("ab", 0) != seed_from("ab", 1)
    assert 0 <= seed_from("ab", 0) < 1 << 63
