"""What a worker answered, taken for what it can be: the record of the work that it was given."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from codecbench.core.contracts.confinement import confines
from codecbench.core.contracts.executor import Finished
from codecbench.core.engine.environment import environment_id
from codecbench.core.engine.foreign_text import clean_line, clean_text
from codecbench.core.engine.planning.model import Cell, CodingJob
from codecbench.core.engine.running.schedule import Work
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage
from codecbench.core.engine.storage.record import Record, RecordDamage, bytes_from_record, record_from_bytes

_NO_FILE: Final = ("", ".", "..")


def outcome_of(work: Work, finished: Finished) -> Record | BitstreamDamage | OSError:
    """The record, the damage or the full disk that a task of this work ended with.

    What a confined worker answers is looked at first, because a stranger may have written it: a failure where it is no
    record of that work. `worker` of the record is empty where no worker lived to tell.
    """
    answer = finished.value
    if finished.status != "ok":
        reason = clean_line(_blamed(work, finished.reason))
        return Record(work.id, finished.status, reason, clean_text(finished.traceback))
    if not confines(work.company):
        return answer  # type: ignore[no-any-return]
    if isinstance(answer, BitstreamDamage) and isinstance(work, Cell):
        return BitstreamDamage(clean_line(str(answer)))
    try:
        _check(work, answer)
    except (RecordDamage, TypeError, ValueError, AttributeError) as error:
        reason = _blamed(work, f"its worker answered what is no record of it: {error}")
        return Record(work.id, "failed", clean_line(reason))
    return answer  # type: ignore[no-any-return]


def _check(work: Work, record: Record) -> None:
    """Raise an error where this is no record, that of something else or others, or asks for files out of its folder."""
    if record.cell_id != work.id:
        raise ValueError(f"it is of {record.cell_id}")
    named = [name for name in record.contents if "/" in name or "\0" in name or name in _NO_FILE]
    if named:
        raise ValueError(f"{named[0]!r} is no name of a file")
    if not all(isinstance(content, bytes) for content in record.contents.values()):
        raise TypeError("a file has no content")
    if record.environment is not None and environment_id(record.environment_description) != record.environment:
        raise ValueError("its environment is another one")
    if record.worker.get("company") != list(work.company) or not {"host", "pid", "checked"} <= record.worker.keys():
        raise ValueError("its worker is another one")
    record_from_bytes(bytes_from_record(replace(record, files={})), known_good=True)


def _blamed(work: Work, reason: str) -> str:
    """Why there is no record, with the plugins of other distributions whose code ran there."""
    strangers = [plugin.full_name for plugin in work.plugins if plugin.distribution]
    doing = "encoding" if isinstance(work, CodingJob) else "evaluating"
    return f"{' or '.join(strangers)} while {doing}: {reason}" if strangers else reason
