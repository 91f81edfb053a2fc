"""What a confined worker answers is a record of its work, or a failure that says what it is instead."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from codecbench.core.contracts.confinement import VARIABLE
from codecbench.core.contracts.executor import Finished
from codecbench.core.engine.planning.model import Cell, CodingJob, PluginSetting, SequenceEntry
from codecbench.core.engine.running.answer import outcome_of
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage
from codecbench.core.engine.storage.record import Record

SEQUENCE = SequenceEntry("s", PluginSetting("dataset", "d", "1"), "f", 2, 1, False, False)
CODEC = PluginSetting("codec", "odd", "1", distribution="odd 1")
JOB = CodingJob("job", SEQUENCE, CODEC)
CELL = Cell("cell", SEQUENCE, CODEC, PluginSetting("evaluator", "e", "1"), 0, 0, False, "job")
WORKER = {"host": "here", "pid": 7, "company": ["odd 1"], "checked": True}
ANSWER = Record("cell", "ok", worker=WORKER, contents={"plot.csv": b"1"})


@pytest.fixture(autouse=True)
def _confined(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "1")


def test_a_record_of_the_work_is_taken() -> None:
    assert outcome_of(CELL, Finished("cell", "ok", ANSWER)) is ANSWER


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        (replace(ANSWER, cell_id="other"), "it is of other"),
        (replace(ANSWER, contents={"../plot.csv": b"1"}), "'../plot.csv' is no name of a file"),
        (replace(ANSWER, contents={"plot.csv": "text"}), "a file has no content"),
        (replace(ANSWER, environment="another"), "its environment is another one"),
        (replace(ANSWER, worker={}), "its worker is another one"),
        (replace(ANSWER, worker=WORKER | {"company": []}), "its worker is another one"),
        (replace(ANSWER, worker={"company": ["odd 1"]}), "its worker is another one"),
        (None, "'NoneType' object has no attribute 'cell_id'"),
    ],
)
def test_anything_else_is_a_failure(answer: Any, reason: str) -> None:
    outcome = outcome_of(CELL, Finished("cell", "ok", answer))
    assert isinstance(outcome, Record)
    assert (outcome.cell_id, outcome.status, outcome.worker) == ("cell", "failed", {})
    beginning = "codec odd of odd 1 while evaluating: its worker answered what is no record of it: "
    assert outcome.reason == beginning + reason


def test_bitstreams_can_be_damaged_where_they_are_read_and_not_where_they_are_made() -> None:
    damage = BitstreamDamage("frame 1 \x1b[2J")
    found = outcome_of(CELL, Finished("cell", "ok", damage))
    assert isinstance(found, BitstreamDamage)
    assert str(found) == r"frame 1 \x1b[2J"
    outcome = outcome_of(JOB, Finished("job", "ok", damage))
    assert isinstance(outcome, Record)
    assert outcome.status == "failed"


def test_a_worker_that_did_not_live_to_tell_is_told_with_whose_code_ran_there() -> None:
    outcome = outcome_of(JOB, Finished("job", "crashed", reason="its worker died of SIGSEGV", traceback="a\x1bb"))
    assert outcome == Record(
        "job", "crashed", "codec odd of odd 1 while encoding: its worker died of SIGSEGV", r"a\x1bb"
    )
