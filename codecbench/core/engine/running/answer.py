"""What a worker answered: the record of the work that it was given, or why there is none."""

from __future__ import annotations

from codecbench.core.contracts.executor import Finished
from codecbench.core.engine.foreign_text import clean_line, clean_text
from codecbench.core.engine.planning.model import CodingJob
from codecbench.core.engine.running.schedule import Work
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage
from codecbench.core.engine.storage.record import Record


def outcome_of(work: Work, finished: Finished) -> Record | BitstreamDamage | OSError:
    """The record, the damage or the full disk that a task of this work ended with.

    `worker` of a record is empty where none lived to tell.
    """
    if finished.status == "ok":
        return finished.value  # type: ignore[no-any-return]
    strangers = [plugin.full_name for plugin in work.plugins if plugin.distribution]
    doing = "encoding" if isinstance(work, CodingJob) else "evaluating"
    reason = f"{' or '.join(strangers)} while {doing}: {finished.reason}" if strangers else finished.reason
    return Record(work.id, finished.status, clean_line(reason), clean_text(finished.traceback))
