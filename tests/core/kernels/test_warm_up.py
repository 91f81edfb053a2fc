"""Kernels compiled ahead: recorded, listed, compiled once by whoever comes first, and never a reason to fail."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from distributions import register
from project import SUPPORT

from codecbench.core.contracts.executor import Finished
from codecbench.core.engine.running.warm_up import WarmUp
from codecbench.core.kernels.manifest import Entry

PACKAGE = {
    "__init__.py": """
from codecbench import PluginSpec, hookimpl

@hookimpl
def codecbench_codecs():
    return [PluginSpec("halving", "halving.codec:Halving", "a codec with kernels")]
""",
    "kernels.py": """
from codecbench import kernel

@kernel
def halved(value):
    return value >> 1

@kernel
def halve(pixels, out):
    for i in range(pixels.size):
        out[i] = halved(pixels[i])
""",
    "codec.py": """
import numpy as np
from plain_plugins import Shift
from codecbench import Capabilities, NULL_TRACE
from halving.kernels import halve

class Halving(Shift):
    name = "halving"
    capabilities = Capabilities(channels=(1,), counts_operations=True)
    kernels = ("halving",)

    def encode(self, image, *, trace=NULL_TRACE):
        out = np.empty(image.size, np.uint8)
        with trace.stage("halve") as run:
            run(halve, np.ascontiguousarray(image).reshape(-1), out)
        return super().encode(out.reshape(image.shape), trace=trace)
""",
}
MATRIX = """
version: 1
name: halves
sequences: [{use: ramp, params: {frames: 2}}]
codecs: [halving]
evaluators: [EVALUATORS]
run: {workers: 2}
"""


class Place:
    """A site with a third-party package that has kernels, and a cache of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.site, self.cache = folder, folder / "site", folder / "cache"
        (self.site / "halving").mkdir(parents=True)
        for name, text in PACKAGE.items():
            (self.site / "halving" / name).write_text(text)
        plain = SUPPORT / "plain_plugins.py"
        (self.site / plain.name).write_text(plain.read_text())
        register(self.site, "plain", "1", "plain_plugins")
        register(self.site, "halving", "1", "halving")
        for name, evaluators in (("fast", "error"), ("counting", "error, operations")):
            (folder / f"{name}.yaml").write_text(MATRIX.replace("EVALUATORS", evaluators))

    @property
    def manifest(self) -> Path:
        return self.site / "halving" / "kernels.json"

    @property
    def kept(self) -> list[str]:
        """Kernels and builds in the cache."""
        return sorted(path.name.rpartition("-")[0] for path in (self.cache / "kernels").glob("*.bin"))

    def call(self, *words: str, **variables: str) -> str:
        environment = {**os.environ, "PYTHONPATH": str(self.site), "CODECBENCH_CACHE": str(self.cache), **variables}
        command = [sys.executable, "-m", "codecbench", *words]
        done = subprocess.run(command, cwd=self.folder, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout + done.stderr


def numbers_of(out: str) -> tuple[int, ...]:
    """How many kernels `warm-up` had to compile, and how many of them failed, from its last line."""
    compiled, failed = out.splitlines()[-1].split(", ")[:2]
    return int(compiled.split()[0]), int(failed.split()[0])


def test_work_waits_for_its_own_kernels_and_long_work_for_none() -> None:
    first, second, late = (
        Entry(f"module:{name}", "fast", "int64", 1.0, stage) for name, stage in (("a", 0), ("b", 0), ("late", 1))
    )
    warm_up = WarmUp({late: (), first: (), second: ()}, {"cell": frozenset({second, late}), "job": frozenset({first})})
    assert warm_up.is_ready("another cell")
    taken = [warm_up.take(), warm_up.take()]
    assert [task.argument[0] for task in taken if task] == [first, second]
    assert warm_up.take() is None, "what only longer work comes to waits for the others"
    assert not warm_up.is_ready("job")
    assert taken[1] is not None
    assert warm_up.finish(Finished(taken[1].id, "failed", reason="no compiler"))
    assert warm_up.is_ready("cell"), "it compiles at the first call what could not be compiled ahead"
    assert not warm_up.finish(Finished("cell", "ok"))
    assert taken[0] is not None
    assert warm_up.finish(Finished(taken[0].id, "ok"))
    last = warm_up.take()
    assert last is not None
    assert last.argument[0] == late
    assert (len(warm_up), warm_up.failed) == (1, 1)
    assert "2 of 3" in warm_up.progress


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Place:
    place = Place(tmp_path_factory.mktemp("recorded"))
    assert str(place.manifest) in place.call("warm-up", "counting.yaml", "--record", "halving")
    return place


@pytest.fixture
def place(recorded: Place, tmp_path: Path) -> Place:
    made = Place(tmp_path)
    made.manifest.write_text(recorded.manifest.read_text())
    return made


@pytest.mark.thorough
def test_what_a_matrix_calls_is_recorded(recorded: Place) -> None:
    entries = json.loads(recorded.manifest.read_text())
    assert [(entry["kernel"], entry["build"], entry["arguments"]) for entry in entries] == [
        ("halving.kernels:halve", "counting", "int64[::1], uint8[::1], uint8[::1]"),
        ("halving.kernels:halve", "fast", "uint8[::1], uint8[::1]"),
    ], "what halve calls is compiled with it"
    assert recorded.kept == [], "recording leaves the cache alone"


@pytest.mark.thorough
def test_a_matrix_gets_the_builds_that_it_needs_once(place: Place) -> None:
    out = place.call("warm-up", "fast.yaml")
    assert "halving.kernels:halve fast" in out
    assert numbers_of(out) == (1, 0)
    assert place.kept == ["halving.kernels.halve.fast", "halving.kernels.halved.fast"]
    out = place.call("warm-up", "counting.yaml")
    assert numbers_of(out) == (1, 0), "what is there is not compiled again"
    assert "halving.kernels.halve.counting" in place.kept
    assert numbers_of(place.call("warm-up", "counting.yaml")) == (0, 0)


@pytest.mark.thorough
def test_a_folder_of_compiled_kernels_serves_an_empty_cache(place: Place) -> None:
    assert numbers_of(place.call("warm-up", "fast.yaml", "--out", "carried")) == (1, 0)
    (file,) = (place.folder / "carried").iterdir()
    assert file.name.startswith("halving.kernels.halve.fast-"), "what it calls is in it"
    empty = {"CODECBENCH_CACHE": str(place.folder / "empty")}
    carried = {**empty, "CODECBENCH_KERNELS": "carried"}
    assert numbers_of(place.call("warm-up", "fast.yaml", **carried)) == (0, 0)
    assert "cells: 1 ok" in place.call("run", "fast.yaml", **carried)
    assert not list((place.folder / "empty" / "kernels").glob("halving.*.bin")), "nothing that was carried is compiled"
    file.chmod(0o664)
    refused = place.call("run", "fast.yaml", "--out", "refused", **carried)
    assert "cells: 1 ok" in refused
    assert list((place.folder / "empty" / "kernels").glob("halving.kernels.halve.fast-*.bin")), "compiled again"


@pytest.mark.slow
def test_a_run_compiles_ahead_and_says_so(place: Place) -> None:
    place.call("run", "counting.yaml")
    assert "halving.kernels.halve.counting" in place.kept
    before = {path: path.stat().st_mtime_ns for path in (place.cache / "kernels").glob("*.bin")}
    place.call("run", "counting.yaml", "--out", "again")
    assert {path: path.stat().st_mtime_ns for path in (place.cache / "kernels").glob("*.bin")} == before
    assert not list((place.cache / "kernels").glob("*.lock"))


def entry(kernel: str, arguments: str) -> str:
    """A manifest of one kernel."""
    return json.dumps(
        [{"kernel": f"halving.kernels:{kernel}", "build": "fast", "arguments": arguments, "seconds": 1.0}]
    )


@pytest.mark.thorough
@pytest.mark.parametrize(
    "content",
    [
        pytest.param("{not json", id="not JSON"),
        pytest.param(entry("gone", "int64"), id="no such kernel", marks=pytest.mark.slow),
        pytest.param(entry("halve", "float99"), id="no such type", marks=pytest.mark.slow),
        pytest.param(entry("halve", "int64, int64"), id="does not compile"),
        pytest.param(None, id="no manifest", marks=pytest.mark.slow),
    ],
)
def test_a_bad_manifest_fails_no_run(place: Place, content: str | None) -> None:
    if content is None:
        place.manifest.unlink()
    else:
        place.manifest.write_text(content)
    assert "cells: 2 ok" in place.call("run", "counting.yaml")
    log = (place.folder / "runs" / "halves" / "run.log").read_text()
    assert "WARNING" in log
    assert "record it" in log or "halving.kernels" in log
