"""What decides which cells of a plan are kept, on records that were written without a run."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import plain_plugins
import pytest
from pydantic import Field

from codecbench import Params, ParamsError, PluginUse
from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.model import Plan, plan_from_json
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.running.resume import kept_cells, outdated_cells, resume
from codecbench.core.engine.storage.record import Record, cell_description
from codecbench.core.engine.storage.store import Store

MATRIX = """
version: 1
sequences: [ramp, {use: ramp, name: long, params: {frames: 9}}]
codecs: [{use: shift, params: {bits: {grid: [0, 3]}}}, absent]
evaluators: [error, stopwatch]
"""


@dataclass
class Folder:
    """A run folder, and plans of the matrix with the plugins as they are now."""

    path: Path
    registry: Registry = field(init=False)

    def __post_init__(self) -> None:
        ours = EntryPoint("executors", "codecbench.plugins.executors", "codecbench")
        self.registry = Registry([EntryPoint("plain", "plain_plugins", "codecbench"), ours])
        self.store = Store(self.path / "run")

    def plan(self, text: str = MATRIX) -> Plan:
        (self.path / "matrix.yaml").write_text(text)
        return make_plan(read_matrix(self.path / "matrix.yaml", self.registry), self.registry)

    def write(self, plan: Plan, change: Callable[[Record], Record] = lambda record: record) -> None:
        """A record for every cell, as a run leaves them."""
        with self.store.locked():
            for cell in plan.cells:
                status = "ok" if cell.unsupported is None else "unsupported"
                described = cell_description(cell)
                record = Record(cell.id, status, cell.unsupported or "", cell=described)  # type: ignore[arg-type]
                self.store.write_record(change(record))

    def resume(self, plan: Plan, *recompute: str) -> Any:
        with self.store.locked():
            return resume(plan, self.store, self.registry, recompute)

    def outdated(self, plan: Plan) -> set[str]:
        return set(outdated_cells(plan, self.store.entries(), self.store).values())


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path)


def test_what_was_computed_is_kept_and_an_unchanged_reason_is_not_recorded_again(folder: Folder) -> None:
    plan = folder.plan()
    folder.write(plan)
    found = folder.resume(plan)
    assert found.kept == {cell.id: "ok" if cell.unsupported is None else "unsupported" for cell in plan.cells}
    assert (found.damaged, found.outdated, found.retried) == ({}, {}, 0)
    other = replace(plan, cells=tuple(replace(c, unsupported=c.unsupported and "another") for c in plan.cells))
    assert set(kept_cells(other, folder.store.entries()).values()) == {"ok"}


def test_what_failed_is_tried_again_and_what_is_damaged_is_removed(folder: Folder) -> None:
    plan = folder.plan()
    failed, damaged = plan.cells[0].id, plan.cells[1].id
    folder.write(plan, lambda record: replace(record, status="failed") if record.cell_id == failed else record)
    (folder.store.record_folder(damaged) / "record.json").write_bytes(b"{}")
    found = folder.resume(plan)
    assert set(found.damaged) == {damaged}
    assert found.retried == 1
    assert {cell.id for cell in plan.cells} - set(found.kept) == {failed, damaged}
    assert not folder.store.record_folder(damaged).exists()
    assert folder.store.record_folder(failed).exists(), "its reason stays until there is a better one"


def test_names_that_are_asked_for_are_computed_again(folder: Folder) -> None:
    plan = folder.plan()

    def recomputed(*names: str) -> set[tuple[str, str, str]]:
        folder.write(plan)
        for job in plan.jobs:
            folder.store.write_coded(job.id, b"x")
        found = folder.resume(plan, *names)
        cells = [cell for cell in plan.cells if cell.id not in found.kept]
        assert {cell.id for cell in cells} == set(found.outdated)
        return {(cell.sequence.name, cell.codec.name, cell.evaluator.name) for cell in cells}

    assert recomputed("error") == {(s, c, "error") for s in ("ramp", "long") for c in ("shift", "absent")}
    assert all(folder.store.coded_path(job.id).exists() for job in plan.jobs)
    assert recomputed("long", "stopwatch") == {
        ("long", codec, evaluator) for codec in ("shift", "absent") for evaluator in ("error", "stopwatch")
    } | {("ramp", codec, "stopwatch") for codec in ("shift", "absent")}
    assert {job.sequence.name for job in plan.jobs if folder.store.coded_path(job.id).exists()} == {"ramp"}


def test_an_unknown_name_gets_a_suggestion_and_removes_nothing(folder: Folder) -> None:
    plan = folder.plan()
    folder.write(plan)
    with pytest.raises(ParamsError, match=r"'stopwach'; .*'stopwatch'\?.* absent, error, long, ramp, shift"):
        folder.resume(plan, "error", "stopwach")
    assert len(folder.resume(plan).kept) == len(plan.cells)


class MoreParams(Params):
    bits: int = Field(default=0, ge=0, le=7)
    rounding: bool = False


class OtherParams(Params):
    bits: int = Field(default=3, ge=0, le=7)


class FewerParams(Params):
    pass


def test_only_a_changed_default_makes_a_record_outdated(folder: Folder, monkeypatch: pytest.MonkeyPatch) -> None:
    only_default = MATRIX.replace("{use: shift, params: {bits: {grid: [0, 3]}}}", "shift")
    before = folder.plan(only_default)
    folder.write(before)
    monkeypatch.setattr(plain_plugins.Shift, "params_type", MoreParams)
    more = folder.plan(only_default)
    assert [cell.id for cell in more.cells] == [cell.id for cell in before.cells]
    assert [job.id for job in more.jobs] != [job.id for job in before.jobs], "bitstreams say all parameters"
    assert folder.outdated(more) == set()
    monkeypatch.setattr(plain_plugins.Shift, "params_type", OtherParams)
    other = folder.plan(only_default)
    assert [cell.id for cell in other.cells] == [cell.id for cell in before.cells]
    (reason,) = folder.outdated(other)
    assert re.fullmatch("codec shift: .*bits was 0 and is 3", reason)
    monkeypatch.setattr(plain_plugins.Shift, "params_type", FewerParams)
    assert folder.outdated(folder.plan(only_default)) == set()


def test_a_changed_default_that_cannot_change_a_result_keeps_records(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = folder.plan()
    folder.write(before)
    monkeypatch.setattr(plain_plugins.RoundsParams.model_fields["rounds"], "default", 5)
    plain_plugins.RoundsParams.model_rebuild(force=True)
    try:
        more = folder.plan()
        assert {cell.id for cell in before.cells} < {cell.id for cell in more.cells}
        assert folder.outdated(more) == set()
    finally:
        monkeypatch.undo()
        plain_plugins.RoundsParams.model_rebuild(force=True)


def test_a_changed_default_of_a_plugin_that_an_evaluator_runs_counts_too(
    folder: Folder, monkeypatch: pytest.MonkeyPatch
) -> None:
    use = (PluginUse("codec", "shift", {}),)
    monkeypatch.setattr(plain_plugins.ErrorEvaluator, "uses", use)
    plan = folder.plan(MATRIX.replace("[error, stopwatch]", "[error]"))
    assert plan_from_json(json.loads(json.dumps(plan.as_json()))) == plan
    folder.write(plan)
    assert folder.outdated(plan) == set()
    monkeypatch.setattr(plain_plugins.Shift, "params_type", OtherParams)
    changed = folder.plan(MATRIX.replace("[error, stopwatch]", "[error]"))
    (why,) = folder.outdated(changed)
    assert re.search(r"^codec shift: .*bits .* 0 .* 3$", why)
