"""Plans: the right cells, identities that change exactly when results can, and reasons for what cannot be done."""

from __future__ import annotations

import json
from importlib.metadata import EntryPoint
from pathlib import Path

import plain_plugins
import pytest

from codecbench.core.contracts.codec import Capabilities
from codecbench.core.contracts.errors import MatrixError
from codecbench.core.contracts.image import Layout
from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.model import Plan, plan_from_json
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import Registry

MATRIX = """
version: 1
sequences:
  - {use: ramp, params: {frames: 4}}
codecs:
  - {use: shift, params: {bits: {grid: [0, 3]}}}
evaluators: [error, stopwatch]
"""


@pytest.fixture(scope="module")
def registry() -> Registry:
    ours = EntryPoint("executors", "codecbench.plugins.executors", "codecbench")
    return Registry([EntryPoint("plain", "plain_plugins", "codecbench"), ours])


@pytest.fixture
def plan(tmp_path: Path, registry: Registry):  # type: ignore[no-untyped-def]
    def make(text: str = MATRIX) -> Plan:
        path = tmp_path / "matrix.yaml"
        path.write_text(text)
        return make_plan(read_matrix(path, registry), registry)

    return make


def test_every_combination_is_a_cell_and_coding_is_shared(plan) -> None:  # type: ignore[no-untyped-def]
    made = plan()
    assert [(c.codec.label, c.evaluator.name, c.repeat) for c in made.cells] == [
        *[("bits=0", "error", 0), ("bits=0", "stopwatch", 0), ("bits=0", "stopwatch", 1)],
        *[("bits=3", "error", 0), ("bits=3", "stopwatch", 0), ("bits=3", "stopwatch", 1)],
    ]
    assert [job.codec.label for job in made.jobs] == ["bits=0", "bits=3"]
    assert {cell.job_id for cell in made.cells if cell.evaluator.name == "error"} == {job.id for job in made.jobs}
    assert all(cell.job_id is None and cell.exclusive for cell in made.cells if cell.evaluator.name == "stopwatch")
    assert len({cell.id for cell in made.cells}) == len({cell.seed for cell in made.cells}) == 6


def ids(made: Plan) -> dict[tuple[str, str, int], str]:
    return {(cell.codec.label, cell.evaluator.name, cell.repeat): cell.id for cell in made.cells}


def test_identities_ignore_what_cannot_change_a_result(plan) -> None:  # type: ignore[no-untyped-def]
    before = ids(plan())
    renamed = MATRIX.replace("use: ramp,", "use: ramp, name: other,") + "run: {workers: 1, timeout_s: 5}\nname: x\n"
    assert ids(plan(renamed)) == before
    assert ids(plan(MATRIX.replace("[error, stopwatch]", "[stopwatch, error]"))) == before


def test_a_longer_list_of_repeats_keeps_those_there_were(plan) -> None:  # type: ignore[no-untyped-def]
    before = ids(plan())
    more = ids(plan(MATRIX.replace("stopwatch]", "{use: stopwatch, params: {rounds: 3}}]")))
    assert before.items() <= more.items()
    assert len(more) == len(before) + 2


def test_identities_change_with_versions_parameters_frames_and_seed(plan, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    before = set(ids(plan()).values())
    assert not before & set(ids(plan(MATRIX.replace("frames: 4", "frames: 5"))).values())
    assert not before & set(ids(plan(MATRIX + "run: {seed: 1}\n")).values())
    monkeypatch.setattr(plain_plugins.ErrorEvaluator, "version", "2")
    kept = before & set(ids(plan()).values())
    assert len(kept) == 4
    monkeypatch.setattr(plain_plugins.Shift, "version", "2")
    assert not before & set(ids(plan()).values())


def test_what_cannot_be_computed_here_says_why(plan) -> None:  # type: ignore[no-untyped-def]
    text = MATRIX.replace("evaluators: [error", "  - absent\n  - uninstalled\nevaluators: [camera, error")
    reasons = {(c.codec.name, c.evaluator.name): c.unsupported for c in plan(text).cells}
    assert reasons["shift", "error"] is None
    assert "calibrated camera; ramp" in reasons["shift", "camera"]
    assert "apt install libabsent" in reasons["absent", "error"]
    assert "pip install 'nothing'" in reasons["uninstalled", "error"]
    color = plan(MATRIX.replace("frames: 4", "frames: 4, channels: 3"))
    for fact in ("accepts gray", "of ramp are color"):
        assert fact in color.cells[0].unsupported
    assert color.jobs == ()


def test_layouts_and_meanings_that_nobody_takes_are_unsupported(plan, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    deep = plan(MATRIX.replace("frames: 4", "frames: 4, bits: 16"))
    assert "shift accepts gray frames; those of ramp are 16-bit gray" in deep.cells[0].unsupported
    assert deep.sequences[0].layout == Layout(1, 16)
    monkeypatch.setattr(plain_plugins.Shift, "capabilities", Capabilities((1,), bits=(8, 16)))
    deep = plan(MATRIX.replace("frames: 4", "frames: 4, bits: 16"))
    assert "error reads 8-bit frames; those of ramp are 16-bit gray" in deep.cells[0].unsupported
    monkeypatch.setattr(plain_plugins.ErrorEvaluator, "bits", (8, 16))
    monkeypatch.setattr(plain_plugins.ErrorEvaluator, "needs", frozenset({"depth"}))
    for unit, missing in (("", "error needs depth; the pixels of ramp are intensities"), (", unit_m: 0.001", None)):
        assert plan(MATRIX.replace("frames: 4", f"frames: 4, bits: 16{unit}")).cells[0].unsupported == (
            missing and f"evaluator {missing}"
        )
    for faulty, fault in (
        ("channels: 3, bits: 16", r"3 channel\(s\) of 16 bits; bits must be 8, or 16 with one channel"),
        ("unit_m: 0.001", "depth of 8 bits; depth has 16"),
        ("bits: 16, unit_m: -1", "must be a Depth of a positive unit"),
    ):
        with pytest.raises(MatrixError, match=fault):
            plan(MATRIX.replace("frames: 4", f"frames: 4, {faulty}"))


def test_sequences_that_do_not_open_are_reported_at_their_place(plan) -> None:  # type: ignore[no-untyped-def]
    text = MATRIX.replace("  - {use: ramp", "  - {use: ramp, params: {broken: true}}\n  - {use: ramp")
    with pytest.raises(MatrixError, match=r":4:5: .*\[0\]: ramp\.txt:3: broken"):
        plan(text)


def test_sequences_of_one_name_are_told_apart(plan) -> None:  # type: ignore[no-untyped-def]
    two = MATRIX.replace("{frames: 4}", "{frames: {grid: [4, 5]}}")
    assert [entry.name for entry in plan(two).sequences] == ["ramp", "ramp frames=5"]


def test_a_plan_survives_json(plan) -> None:  # type: ignore[no-untyped-def]
    made = plan(MATRIX.replace("evaluators: [error", "  - absent\nevaluators: [error"))
    assert plan_from_json(json.loads(json.dumps(made.as_json()))) == made
