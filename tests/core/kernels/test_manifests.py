"""The manifests of codecbench itself name kernels that there are, and all that a run calls."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from inspect import signature
from pathlib import Path

import cv2
import numpy as np
import pytest

from codecbench.core.contracts.hooks import KINDS
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.warm_up import declared_kernels
from codecbench.core.kernels.manifest import ManifestError, entries_of
from codecbench.plugins.codecs.multilevel import Multilevel

RUN = """
from numba.core import event
from codecbench.core.engine.plugins.registry import installed

class Compiled(event.Listener):
    def on_start(self, started):
        print("COMPILED", started.data["dispatcher"].py_func, started.data["args"])
    def on_end(self, ended):
        pass

event.register("numba:compile", Compiled())
registry = installed()
sequence = registry.create("dataset", "synthetic", {}).open()
frames = [sequence.read(index) for index in range(len(sequence))]
backend = registry.create("slam_backend", "orb", {})
run = backend.run(frames, sequence.camera, seed=0)
print("TRACKED", sum(frame.state == "tracked" for frame in run.frames), "LOOPS", len(run.loops))
backend.run(frames[:60], sequence.camera, seed=0, keyframe_image=lambda index: frames[index].image)
"""
MATRIX = """
version: 1
name: manifest
sequences: [synthetic]
codecs: [raw]
evaluators: [trajectory]
"""
CODEC_MATRIX = """
version: 1
name: manifest
sequences: [SEQUENCE]
codecs: [{use: multilevel, params: SETTING}]
evaluators: [EVALUATOR]
run: {workers: 1}
"""
RENDERED = "{use: synthetic, params: {stop: 1, width: 64, height: 48}}"
READ = "{use: folder, params: {path: pictures}}"
TIMED = "{use: timing, params: {frames: 1, repeats: 1, warmup: 1, min_ms: 0}}"
"""An evaluator without kernels, as `folder` is a dataset without any: only those of the codec are compiled."""


def test_every_listed_kernel_is_there() -> None:
    names = {
        name
        for kind in KINDS
        for plugin in installed().plugins(kind)
        if plugin.missing is None
        for name in getattr(installed().load(kind, plugin.spec.name), "kernels", ())
    }
    assert {"codecbench.slam", "codecbench.plugins.codecs.dct"} <= names
    for name in sorted(names):
        entries = entries_of(name)
        assert entries, name
        for entry in entries:
            dispatcher, arguments = entry._resolve()  # raises where there is no such kernel, build or type
            signature(dispatcher.py_func).bind(*arguments)


def test_a_module_gets_its_own_entries_and_a_stranger_none() -> None:
    assert {entry.kernel.partition(":")[0] for entry in entries_of("codecbench.slam.features.matching")} == {
        "codecbench.slam.features.matching"
    }
    with pytest.raises(ManifestError, match=r"no kernels\.json for json "):
        entries_of("json")


@pytest.mark.slow
def test_after_warming_up_a_whole_slam_run_compiles_nothing(tmp_path: Path) -> None:
    (tmp_path / "matrix.yaml").write_text(MATRIX)
    environment = {**os.environ, "CODECBENCH_CACHE": str(tmp_path / "cache")}
    warm_up = [sys.executable, "-m", "codecbench", "warm-up", "matrix.yaml"]
    done = subprocess.run(warm_up, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert ", 0 failed" in done.stdout
    command = [sys.executable, "-c", RUN]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    assert "TRACKED 398 LOOPS 1" in done.stdout
    assert [line for line in done.stdout.splitlines() if line.startswith("COMPILED")] == []


def test_a_setting_names_the_kernels_that_it_calls() -> None:
    """The profile `context` is the longest to compile by far, and the static one calls nothing of it."""
    whole, static, context, stream = (
        set(declared_kernels(installed(), "codec", name, params)["kernels"])
        for name, params in (
            ("multilevel", None), ("multilevel", {}), ("multilevel", {"profile": "context"}), ("multilevel_stream", {}),
        )
    )  # fmt: skip
    room = "codecbench.plugins.codecs.multilevel.context"
    assert all(name.startswith(tuple(whole)) for name in static | context | stream)
    assert room in context
    assert not any(name.startswith(room) for name in static | stream)


@pytest.mark.parametrize(
    ("setting", "kernels"),
    [
        ({}, "tables:encode_tuples"),
        ({"color": "ycbcr420"}, "color:halve color:rgb_from_ycbcr tables:encode_tuples"),
        ({"decoding": "search"}, "keys:greedy_search tables:encode_codes"),
        ({"effort": "fast", "scan": "coefficient"}, "levels:_transpose rice:encode_ordered_tuples"),
    ],
)
def test_of_the_kernels_that_differ_a_setting_lists_its_own(setting: dict[str, str], kernels: str) -> None:
    differ = {
        "color:rgb_from_ycbcr", "color:halve", "tables:encode_tuples", "tables:encode_codes",
        "rice:encode_ordered_tuples", "levels:_transpose", "keys:greedy_search",
    }  # fmt: skip
    called = declared_kernels(installed(), "codec", "multilevel", setting)["kernels"]
    listed_ahead = {entry.kernel.rpartition(".")[2] for name in called for entry in entries_of(name)}
    assert " ".join(sorted(listed_ahead & differ)) == kernels


@pytest.mark.parametrize(
    ("setting", "foreign"),
    [({}, "multilevel.context."), ({"profile": "context"}, "multilevel.tables:")],
    ids=["static", "context"],
)
def test_what_a_setting_leaves_out_is_not_compiled_ahead(setting: dict[str, str], foreign: str) -> None:
    called = declared_kernels(installed(), "codec", "multilevel", setting)["kernels"]
    listed_ahead = {entry.kernel for name in called for entry in entries_of(name)}
    everything = {entry.kernel for name in Multilevel.kernels for entry in entries_of(name)}
    assert not [kernel for kernel in listed_ahead if foreign in kernel]
    assert [kernel for kernel in everything if foreign in kernel]


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("setting", "sequence", "evaluator"),
    [
        ({}, RENDERED, "quality"),
        ({"decoding": "search"}, READ, TIMED),
        ({"profile": "context"}, READ, TIMED),
    ],
    ids=["static", "search", "context"],
)
def test_after_its_kernels_a_setting_compiles_nothing(
    setting: dict[str, str], sequence: str, evaluator: str, tmp_path: Path
) -> None:
    (tmp_path / "pictures").mkdir()
    cv2.imwrite(str(tmp_path / "pictures" / "0.png"), np.random.default_rng(1).integers(0, 256, (48, 64, 3), np.uint8))
    matrix = tmp_path / "matrix.yaml"
    text = CODEC_MATRIX.replace("SETTING", json.dumps(setting))
    matrix.write_text(text.replace("SEQUENCE", sequence).replace("EVALUATOR", evaluator))
    environment = {**os.environ, "CODECBENCH_CACHE": str(tmp_path / "cache")}
    for words in (["warm-up", "matrix.yaml"], ["run", "matrix.yaml", "--out", "run"]):
        command = [sys.executable, "-m", "codecbench", *words]
        ended = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert ended.returncode == 0, ended.stdout + ended.stderr
        if words[0] == "warm-up":
            before = sorted(path.name for path in (tmp_path / "cache" / "kernels").glob("*.bin"))
    after = sorted(path.name for path in (tmp_path / "cache" / "kernels").glob("*.bin"))
    assert before
    assert after == before
