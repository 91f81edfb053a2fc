"""The work of workers: encode a sequence, compute a cell. Every failure becomes a status and a reason."""

from __future__ import annotations

import errno
import functools
import gc
import os
import platform
import time
import traceback
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import CodecbenchError, PluginError, Unsupported
from codecbench.core.contracts.executor import Finished, Status, Task
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.engine.hosting.confinement import VARIABLE, confinement, is_confinement_requested
from codecbench.core.engine.hosting.host import PluginLoss
from codecbench.core.engine.planning.model import Cell, CodingJob, RunSettings
from codecbench.core.engine.plugins.serving import keep_memory, seed_generators
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.encoding import encode_sequence
from codecbench.core.engine.running.coding.position import WRITE, WorkPosition
from codecbench.core.engine.running.frame_cache import cache_limit_bytes
from codecbench.core.engine.running.measuring import measure, measure_in_host
from codecbench.core.engine.running.schedule import Work
from codecbench.core.engine.running.workbench import DeclaredPlugins, Workbench
from codecbench.core.engine.storage.aggregate import summarise
from codecbench.core.engine.storage.atomic import open_whole
from codecbench.core.engine.storage.bitstream_file import (
    BitstreamDamage,
    BitstreamFile,
    write_bitstreams,
    write_stream,
)
from codecbench.core.engine.storage.record import SAMPLES_FILE, Record, cell_description
from codecbench.core.engine.storage.samples import parquet_from_samples
from codecbench.core.engine.storage.store import Store
from codecbench.core.engine.text import clean_line, clean_text, describe_error

BITSTREAMS: Final = "bitstreams"
"""Name of a coding job's file among the contents of its record, if the worker did not write it."""

_FULL: Final = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True)
class WorkItem:
    """A coding job to do or a cell to compute."""

    work: Work
    bitstreams: Path | bytes | None = field(repr=False)
    """The file of bitstreams.

    For a job: the file to write, or None to return its content. For a cell: the file to read or its content, or None.
    """
    cache_bytes: int
    """Limit of frames cached in the worker."""
    confines: bool = False
    """Whether hosts of other distributions are to be confined, also on another machine."""


def prepare_worker() -> None:
    """Load what every cell needs, single-threaded, so that the first one is not slower than the others.

    What is loaded stays: garbage collection of it would add a tenth of a second to each time measurement.
    """
    import pyarrow  # only workers need it
    import pyarrow.parquet

    pyarrow.set_cpu_count(1)
    pyarrow.set_io_thread_count(1)
    keep_memory()
    _ = _workbench().environment
    gc.freeze()


def perform(item: WorkItem, bench: Workbench | None = None) -> Record | BitstreamDamage | OSError:
    """Do the work and return its record, or why the bitstreams, which can be made again, could not be read.

    An OSError is a full disk while writing bitstreams, for which no plugin is to blame. bench: by default, this
    worker's.
    """
    begin_s, started = time.monotonic(), datetime.now(UTC)
    work, bench, position = item.work, bench or _workbench(), WorkPosition(titles=_titles(item.work))
    seed_generators(_seed(work))
    os.environ[VARIABLE] = "1" if item.confines else "0"
    try:
        do = _encode if isinstance(work, CodingJob) else _evaluate
        record = do(work, item, bench, position)  # type: ignore[arg-type]
    except BitstreamDamage as damage:
        return BitstreamDamage(_reason(damage, position))
    except BaseException as error:  # noqa: BLE001 - every failure of a cell becomes its record
        if isinstance(error, OSError) and error.errno in _FULL and position.stage == WRITE:
            return error
        record = _failure(work, error, position)
    finally:
        bench.tidy(_shared_job_id(work))
    return replace(
        record,
        environment=bench.environment,
        environment_description=bench.environment_description,
        started_utc=started.isoformat(timespec="milliseconds"),
        duration_s=time.monotonic() - begin_s,
        worker=_worker(work),
        code=bench.code(work.plugins),
        cell=cell_description(work) if isinstance(work, Cell) else {},
    )


def _worker(work: Work) -> dict[str, Any]:
    """Return where the work was done, and what confined other distributions' code, if anything did."""
    is_confined = is_confinement_requested() and any(plugin.distribution for plugin in work.plugins)
    return {"host": platform.node(), "pid": os.getpid(), **({"confined": confinement()} if is_confined else {})}


def _shared_job_id(work: Work) -> str:
    """Return the coding job whose host the next cell may use for decoding too; empty if it may not."""
    return "" if isinstance(work, CodingJob) or work.exclusive else work.job_id or ""


def _seed(work: Work) -> int:
    """Return the seed of global random generators, so that results do not depend on earlier work."""
    return int(work.id[:8], 16)


def _failure(work: Work, error: BaseException, position: WorkPosition) -> Record:
    status: Status = (
        "unsupported" if isinstance(error, Unsupported) else "crashed" if isinstance(error, PluginLoss) else "failed"
    )
    trace = clean_text("".join(traceback.format_exception(error)))
    return Record(work.id, status, _reason(error, position), trace)


def _reason(error: BaseException, position: WorkPosition) -> str:
    """Return one line: where the work had got to, and what happened there."""
    text = describe_error(error)
    if isinstance(error, CodecbenchError):
        text = text.removeprefix(f"{type(error).__name__}: ")
    return clean_line(" ".join((f"{position}: {text}" if str(position) else text).split()))


def _titles(work: Work) -> dict[str, str]:
    """Return the plugins of other distributions by the stage at which their code runs."""
    settings = {"open": work.sequence.dataset, "read": work.sequence.dataset}
    settings |= dict.fromkeys(("construct codec", "encode", "decode", "remark", "libraries"), work.codec)
    if isinstance(work, Cell):
        used = next((setting for setting in work.evaluator.uses if setting.distribution), work.evaluator)
        evaluating = work.evaluator if work.evaluator.distribution else used
        settings |= dict.fromkeys(("construct evaluator", "evaluate", "artifacts"), evaluating)
    return {stage: setting.full_name for stage, setting in settings.items() if setting.distribution}


@functools.cache
def _workbench() -> Workbench:
    return Workbench()


def _encode(job: CodingJob, item: WorkItem, bench: Workbench, position: WorkPosition) -> Record:
    position.at("open")
    sequence = bench.sequence(job.sequence, item.cache_bytes)
    position.at("construct codec")
    codec: AnyCodec[Any] = bench.create(job.codec, job.id, _seed(job), "encode")
    if isinstance(item.bitstreams, Path):
        position.at(WRITE)
        with open_whole(item.bitstreams) as file:
            _write_coded(file, codec, sequence, job.id, position)
        return Record(job.id, "ok")
    content = BytesIO()
    _write_coded(content, codec, sequence, job.id, position)
    return Record(job.id, "ok", contents={BITSTREAMS: content.getvalue()})


def _write_coded(
    stream: BinaryIO, codec: AnyCodec[Any], sequence: FrameSequence, job_id: str, position: WorkPosition
) -> None:
    """Encode the sequence into a file of the job."""
    packets = encode_sequence(codec, sequence, position)
    if codec.stateless:
        write_bitstreams(stream, (packet.data for packet in packets), job_id)
    else:
        write_stream(stream, packets, job_id)


def _evaluate(cell: Cell, item: WorkItem, bench: Workbench, position: WorkPosition) -> Record:
    position.at("open")
    sequence = bench.sequence(cell.sequence, item.cache_bytes)
    position.at("construct codec")
    codec: AnyCodec[Any] = bench.create(cell.codec, _shared_job_id(cell) or cell.id, _seed(cell))
    coded: CodedFrames | None = None
    if cell.job_id is not None:
        assert item.bitstreams is not None
        bitstreams = BitstreamFile(item.bitstreams, cell.job_id)
        coded = CodedFrames(sequence, codec, bitstreams, position, bench.pictures(bitstreams, item.cache_bytes))
    position.at("construct evaluator")
    plugins = DeclaredPlugins(bench, cell)
    measured = (
        measure_in_host(bench, cell, coded or codec, sequence, plugins, position)
        if bench.is_hosted(cell.evaluator)
        else measure(bench.create(cell.evaluator, cell.id), coded or codec, sequence, cell, plugins, position)
    )
    if coded is not None:
        position.at("decode")
        coded.check(lambda: bench.create(cell.codec, f"{cell.id} alone", _seed(cell)))
    position.at("remark")
    notes = (*_remarks(codec, sequence.bits), *(() if coded is None else coded.notes))
    position.at("libraries")
    libraries = _libraries(codec)
    contents, samples = measured.artifacts, [m for m in measured.measurements if m.frame is not None]
    if samples:
        contents[SAMPLES_FILE] = parquet_from_samples(samples)
    return Record(
        cell.id,
        "ok",
        measurements=tuple(measurement for measurement in measured.measurements if measurement.frame is None),
        summaries=summarise(samples, measured.metrics),
        metrics=tuple(metric.name for metric in measured.metrics),
        libraries=libraries,
        notes=notes,
        contents=contents,
    )


def _remarks(codec: AnyCodec[Any], bits: int) -> tuple[str, ...]:
    remark = codec.remark_at(bits)
    if not isinstance(remark, str):
        raise PluginError(f"remark returned {clean_line(repr(remark))}; it must return text")
    return (clean_line(remark),) if remark else ()


def _libraries(codec: AnyCodec[Any]) -> dict[str, str]:
    versions = codec.libraries()
    if not isinstance(versions, dict) or not all(isinstance(text, str) for pair in versions.items() for text in pair):
        raise PluginError(f"libraries returned {clean_line(repr(versions))}; it must return names with their versions")
    return {clean_line(name): clean_line(version) for name, version in versions.items()}


def task_of(work: Work, settings: RunSettings, store: Store, shares_files: bool) -> Task:
    """Return a job or cell as a task. shares_files: whether the executor's workers see the run folder."""
    item = WorkItem(
        work, _bitstreams(work, store, shares_files), cache_limit_bytes(settings.memory_mb), is_confinement_requested()
    )
    exclusive = isinstance(work, Cell) and work.exclusive
    limits = settings.timeout_s, settings.memory_mb
    return Task(work.id, perform, item, *limits, exclusive)


def _bitstreams(work: Work, store: Store, shares_files: bool) -> Path | bytes | None:
    """Return the file that a job writes or a cell reads; its content if workers do not see the folder."""
    job_id = work.id if isinstance(work, CodingJob) else work.job_id
    if job_id is None:
        return None
    path = store.coded_path(job_id).absolute()
    if shares_files:
        return path
    return None if isinstance(work, CodingJob) else path.read_bytes()


def outcome_of(work: Work, finished: Finished) -> Record | BitstreamDamage | OSError:
    """Return the record, the damage or the full disk that a task of this work ended with.

    `worker` of a record is empty if its worker died.
    """
    if finished.status == "ok":
        return finished.value  # type: ignore[no-any-return]
    foreign_plugins = [plugin.full_name for plugin in work.plugins if plugin.distribution]
    activity = "encoding" if isinstance(work, CodingJob) else "evaluating"
    reason = (
        f"{' or '.join(foreign_plugins)} while {activity}: {finished.reason}" if foreign_plugins else finished.reason
    )
    return Record(work.id, finished.status, clean_line(reason), clean_text(finished.traceback))
