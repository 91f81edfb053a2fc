"""The manifests of codecbench itself name kernels that there are, and all that a run calls."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from codecbench.core.contracts.hooks import KINDS
from codecbench.core.engine.registry import installed
from codecbench.core.kernels.manifest import ManifestError, listed

RUN = """
from numba.core import event
from codecbench.core.engine.registry import installed

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
        entries = listed(name)
        assert entries, name
        for entry in entries:
            entry.is_kept()  # raises where there is no such kernel, build or type


def test_a_module_gets_its_own_entries_and_a_stranger_none() -> None:
    assert {entry.kernel.partition(":")[0] for entry in listed("codecbench.slam.features.matching")} == {
        "codecbench.slam.features.matching"
    }
    with pytest.raises(ManifestError, match=r"no kernels.json beside json or above it"):
        listed("json")


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
