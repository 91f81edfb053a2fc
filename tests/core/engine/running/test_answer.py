"""What a worker answered becomes a record, also where it did not live to answer."""

from __future__ import annotations

import pytest

from codecbench.core.contracts.executor import Finished
from codecbench.core.engine.planning.model import Cell, CodingJob, PluginSetting, SequenceEntry
from codecbench.core.engine.running.schedule import Work
from codecbench.core.engine.running.work import outcome_of
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage
from codecbench.core.engine.storage.record import Record

SEQUENCE = SequenceEntry("s", PluginSetting("dataset", "d", "1"), "f", 2, 1, False, False)
EVALUATOR = PluginSetting("evaluator", "e", "1")
ODD = PluginSetting("codec", "odd", "1", distribution="odd 1")
CELL = Cell("work", SEQUENCE, ODD, EVALUATOR, 0, 0, False, "job")
OWN = PluginSetting("codec", "png", "1")


@pytest.mark.parametrize("answer", [Record("work", "ok"), BitstreamDamage("frame 1"), OSError(28, "full")], ids=repr)
def test_what_a_worker_answered_is_taken(answer: object) -> None:
    assert outcome_of(CELL, Finished("work", "ok", answer)) is answer


@pytest.mark.parametrize(
    ("work", "activity"),
    [(CodingJob("work", SEQUENCE, ODD), "encoding"), (CELL, "evaluating"), (CodingJob("work", SEQUENCE, OWN), "")],
)
def test_a_dead_workers_record_names_the_foreign_plugin_and_its_activity(work: Work, activity: str) -> None:
    outcome = outcome_of(work, Finished("work", "timed_out", reason="no result", traceback="a\x1bb"))
    beginning = f"{ODD.full_name} while {activity}: " if activity else ""
    assert outcome == Record("work", "timed_out", f"{beginning}no result", r"a\x1bb")
