"""What was computed beside code that changes its process is computed again; no wrong value is kept."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from distributions import install_source
from installed_command import Place

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.engine.planning.model import Cell, PluginSetting, SequenceEntry
from codecbench.core.engine.running.distrust import beside_notice, made_beside
from codecbench.core.engine.storage.record import Record
from codecbench.core.engine.storage.store import Store

WORKER = {"host": "here", "pid": 7, "company": ["bad 1"], "checked": False}
SOURCE = """
import numpy as np
from codecbench import NULL_TRACE, Capabilities, Codec, NoParams, PluginSpec, hookimpl

class Steady(Codec[NoParams]):
    name, version, params_type, capabilities = "steady", "1", NoParams, Capabilities(channels=(1, 3))
    def encode(self, image, *, trace=NULL_TRACE):
        return bytes([image.ndim]) + b"".join(n.to_bytes(2, "big") for n in image.shape) + (image & 0xF0).tobytes()
    def decode(self, bitstream, *, trace=NULL_TRACE):
        start = 1 + 2 * bitstream[0]
        shape = [int.from_bytes(bitstream[n : n + 2], "big") for n in range(1, start, 2)]
        return np.frombuffer(bitstream[start:], np.uint8).reshape(shape).copy()

class Turning(Steady):
    name, frames = "turning", 0
    def decode(self, bitstream, *, trace=NULL_TRACE):
        Turning.frames += 1
        if Turning.frames > 3:
            np.mean = lambda *_, **__: 42.0
        return super().decode(bitstream)

@hookimpl
def codecbench_codecs():
    return [PluginSpec("turning", "turn_table:Turning", ""), PluginSpec("steady", "turn_table:Steady", "")]
"""
MATRIX = """
version: 1
name: NAME
sequences: [{use: synthetic, name: short, params: {stop: 2}}, {use: synthetic, name: long, params: {stop: 5}}]
codecs: [CODECS]
evaluators: [quality]
run: {workers: 1}
"""


def cell(number: int, codec_of: str = "", evaluator_of: str = "") -> Cell:
    sequence = SequenceEntry("s", PluginSetting("dataset", "d", "1"), "f", 2, 1, False, False)
    codec = PluginSetting("codec", "c", "1", distribution=codec_of)
    evaluator = PluginSetting("evaluator", "e", "1", distribution=evaluator_of)
    return Cell(f"{number:04}", sequence, codec, evaluator, 0, 0, False, f"job{number}")


def suspected(cell: Cell, worker: dict[str, Any], coded: bool = True) -> list[bool]:
    """Whether its bitstreams are encoded again, where the cell is suspected at all."""
    store: Any = SimpleNamespace(
        read_record=lambda id_: Record(id_, "ok", worker=worker), has_coded=lambda job, frames: coded
    )
    return [encode for _, encode in made_beside(["bad 1"], WORKER, [cell], store)]


def test_cells_of_other_company_and_those_checked_since_are_kept() -> None:
    other = {"host": "here", "pid": 8}
    assert suspected(cell(1), {**other, "company": [], "checked": True}) == []
    assert suspected(cell(1), {**other, "company": ["good 1"]}) == []
    assert suspected(cell(1, "bad 1"), {**other, "company": ["bad 1"], "checked": True}) == []


def test_cells_of_the_same_worker_of_before_the_check_or_of_nobody_knows_whom_are_not() -> None:
    assert suspected(cell(1, evaluator_of="bad 1"), {**WORKER, "checked": True}) == [False]
    assert suspected(cell(1, evaluator_of="bad 1"), {**WORKER, "checked": True}, coded=False) == [True]
    assert suspected(cell(1, codec_of="bad 1"), {"host": "here", "pid": 8, "company": ["good 1", "bad 1"]}) == [True]
    assert suspected(cell(1), {"host": "here", "pid": 8}) == [True]


def test_the_notice_counts() -> None:
    assert beside_notice(1, ["bad 1"]).startswith("1 cell that was computed beside bad 1")
    assert beside_notice(2, ["a 1", "b 1"]).startswith("2 cells that were computed beside a 1 or b 1")


def run(place: Place, name: str, codecs: str) -> dict[tuple[str, str], tuple[Any, ...]]:
    """Status, measurements and summaries of each sequence and codec."""
    (place.folder / f"{name}.yaml").write_text(MATRIX.replace("NAME", name).replace("CODECS", codecs))
    done = place.call("run", f"{name}.yaml", "--quiet", timeout=300)
    assert "Traceback" not in done.output
    store = Store(place.folder / "runs" / name)
    found = {}
    for cell in store.read_plan().cells:
        record = store.read_record(cell.id)
        found[cell.sequence.name, cell.codec.name] = (record.status, record.measurements, record.summaries)
    return found


@pytest.mark.thorough
def test_no_wrong_value_is_kept_of_a_codec_that_turns_after_its_third_frame(tmp_path: Path) -> None:
    place = Place(tmp_path)
    install_source(place.site, "turn-table", "1", SOURCE)
    right = run(place, "alone", "raw, steady")
    found = run(place, "beside", "raw, turning, steady")
    assert {key: found[key] for key in right} == right
    assert found["short", "turning"][0] == "ok"
    assert found["short", "turning"][1:] == right["short", "steady"][1:]
    assert found["long", "turning"][0] == "failed"

    store = Store(tmp_path / "runs" / "beside")
    made_by = {"raw": {}, "steady": {"company": ["turn-table 1"]}}
    with store.locked():  # as an earlier version would have left them, which computed all in the same workers
        for cell in store.read_plan().cells:
            record = store.read_record(cell.id)
            if cell.codec.name in made_by:
                wrong = tuple(Measurement(m.metric, 42.0, stage=m.stage) for m in record.measurements)
                contents = {name: store.read_file(record, name) for name in record.files}
                worker = {"host": "here", "pid": 1, **made_by[cell.codec.name]}
                store.write_record(replace(record, measurements=wrong, summaries=dict.fromkeys(record.summaries, 42.0),
                                           contents=contents, environment=None, worker=worker))  # fmt: skip
    found = run(place, "beside", "raw, turning, steady")
    assert {key: found[key] for key in right} == right
    assert found["long", "turning"][0] == "failed"
    log = (tmp_path / "runs" / "beside" / "run.log").read_text()
    assert "4 cells that were computed beside turn-table 1, which changes its process, will be computed again" in log
