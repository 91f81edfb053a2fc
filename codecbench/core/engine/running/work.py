"""What workers do: encode a sequence, compute a cell. Whatever goes wrong here becomes a status and a reason."""

from __future__ import annotations

import errno
import functools
import gc
import platform
import random
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.confinement import confined_by, outer_pid
from codecbench.core.contracts.errors import CodecbenchError, PluginError, Unsupported
from codecbench.core.contracts.evaluator import (
    CodecEvaluator,
    Context,
    Evaluator,
    FrameEvaluator,
    Measurement,
    SequenceEvaluator,
)
from codecbench.core.contracts.executor import Status, retirement
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.engine.aggregate import summarise
from codecbench.core.engine.foreign_errors import describe_error
from codecbench.core.engine.foreign_text import clean_line, clean_text
from codecbench.core.engine.planning.model import Cell, CodingJob
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.encoding import encode_sequence
from codecbench.core.engine.running.coding.position import WRITE, WorkPosition
from codecbench.core.engine.running.schedule import Work
from codecbench.core.engine.running.sentinel import Tampering
from codecbench.core.engine.running.workbench import DeclaredPlugins, Workbench
from codecbench.core.engine.storage.atomic import open_whole
from codecbench.core.engine.storage.bitstream_file import (
    BitstreamDamage,
    BitstreamFile,
    write_bitstreams,
    write_stream,
)
from codecbench.core.engine.storage.record import (
    RECORD_FILE,
    SAMPLES_FILE,
    Record,
    bytes_from_record,
    cell_description,
    record_from_bytes,
)
from codecbench.core.engine.storage.samples import MeasurementCheck, MeasurementError, parquet_from_samples

BITSTREAMS: Final = "bitstreams"
"""The name of a coding job's file among the contents of its record, where it was not written by the worker."""

_FULL: Final = (errno.ENOSPC, errno.EDQUOT)


@dataclass(frozen=True)
class Order:
    """A coding job to do or a cell to compute.

    bitstreams: of a job, the file to write, or None to send them back; of a cell, the file to read or its content, or
    None where it reads none. cache_bytes: for frames kept in the worker.
    """

    work: Work
    bitstreams: Path | bytes | None = field(repr=False)
    cache_bytes: int


def prepare_worker() -> None:
    """Load what every cell needs, single-threaded, so that the first one is not slower than the others.

    What is loaded stays: looking for garbage among it would take each measurement of time a tenth of a second.
    """
    import pyarrow
    import pyarrow.parquet

    pyarrow.set_cpu_count(1)
    pyarrow.set_io_thread_count(1)
    _workbench()
    gc.freeze()


def tell_environment(_: object) -> tuple[str, dict[str, Any]]:
    """The id and the description of this worker's environment."""
    return _workbench().environment, _workbench().environment_description


def perform(order: Order) -> Record | BitstreamDamage | OSError:
    """Do the work and return its record, or say why the bitstreams, which can be made again, could not be read.

    An OSError is a full disk where the bitstreams were to be written, which no plugin is to blame for.
    """
    begun, started = time.monotonic(), datetime.now(UTC)
    work, bench, position, checked = order.work, _workbench(), WorkPosition(titles=_titles(order.work)), True
    code: dict[str, str] = {}
    _start_afresh(work.id)
    try:
        bench.join(work.company)
        code = bench.code(work.plugins)
        record = _encode(work, order, position) if isinstance(work, CodingJob) else _evaluate(work, order, position)
        position.at("check")
        bench.check(work.company)
        record = _as_kept(record)
    except BitstreamDamage as damage:
        return BitstreamDamage(_reason(damage, position))
    except BaseException as error:  # noqa: BLE001 - a cell's failure, whatever it is, becomes its record
        if isinstance(error, OSError) and error.errno in _FULL and position.stage == WRITE:
            return error
        record = _failure(work, error, position)
        checked = not isinstance(error, Tampering) and bench.is_sound(work.company)
        retirement.asked = not checked
    return replace(
        record,
        environment=bench.environment,
        environment_description=bench.environment_description,
        started_utc=started.isoformat(timespec="milliseconds"),
        duration_s=time.monotonic() - begun,
        worker=_worker(work, checked),
        code=code,
        cell=cell_description(work) if isinstance(work, Cell) else {},
    )


def _worker(work: Work, checked: bool) -> dict[str, Any]:
    """Where and in whose company the work was done, what confined it, if anything did, and whether it was sound after.

    The process has the number that it is known by outside of its confinement, which no other worker has.
    """
    tool = confined_by()
    confined = {} if tool is None else {"confined": tool}
    company = list(work.company)
    return {"host": platform.node(), "pid": outer_pid(), "company": company, "checked": checked, **confined}


def _failure(work: Work, error: BaseException, position: WorkPosition) -> Record:
    status: Status = "unsupported" if isinstance(error, Unsupported) else "failed"
    try:
        trace = clean_text("".join(traceback.format_exception(error)))
    except Exception as second:  # noqa: BLE001 - of an exception that does more than hold a message
        trace = f"no traceback: {describe_error(second)}"
    return Record(work.id, status, _reason(error, position), trace)


def _reason(error: BaseException, position: WorkPosition) -> str:
    """One line: where the work had got to, and what happened there."""
    text = describe_error(error)
    if isinstance(error, CodecbenchError):
        text = text.removeprefix(f"{type(error).__name__}: ")
    return clean_line(" ".join((f"{position}: {text}" if str(position) else text).split()))


def _titles(work: Work) -> dict[str, str]:
    """The plugins of other distributions by the stage at which their code runs."""
    settings = {"open": work.sequence.dataset, "read": work.sequence.dataset}
    settings |= dict.fromkeys(("construct codec", "encode", "decode", "remark", "libraries"), work.codec)
    if isinstance(work, Cell):
        used = next((setting for setting in work.evaluator.uses if setting.distribution), work.evaluator)
        judge = work.evaluator if work.evaluator.distribution else used
        settings |= dict.fromkeys(("construct evaluator", "evaluate", "artifacts"), judge)
    return {stage: setting.full_name for stage, setting in settings.items() if setting.distribution}


def _as_kept(record: Record) -> Record:
    """The record as it will be read again, so that nothing leaves the worker which only looks like text and numbers."""
    return replace(record_from_bytes(bytes_from_record(record)), contents=record.contents)


def _start_afresh(identity: str) -> None:
    """Undo what an earlier task may have done to the process, so that results do not depend on the order."""
    import cv2

    seed = int(identity[:8], 16)
    cv2.setNumThreads(1)
    cv2.setRNGSeed(seed >> 1)
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - for code of others that draws from the global generator


@functools.cache
def _workbench() -> Workbench:
    return Workbench()


def _encode(job: CodingJob, order: Order, position: WorkPosition) -> Record:
    position.at("open")
    bench = _workbench()
    sequence = bench.sequence(job.sequence, order.cache_bytes)
    position.at("construct codec")
    codec: AnyCodec[Any] = bench.create(job.codec)
    if isinstance(order.bitstreams, Path):
        position.at(WRITE)
        with open_whole(order.bitstreams) as file:
            _write_coded(file, codec, sequence, job.id, position)
        return Record(job.id, "ok")
    content = BytesIO()
    _write_coded(content, codec, sequence, job.id, position)
    return Record(job.id, "ok", contents={BITSTREAMS: content.getvalue()})


def _write_coded(
    file: BinaryIO, codec: AnyCodec[Any], sequence: FrameSequence, job_id: str, position: WorkPosition
) -> None:
    """Encode the sequence into a file of the job."""
    packets = encode_sequence(codec, sequence, position)
    if codec.stateless:
        write_bitstreams(file, (packet.data for packet in packets), job_id)
    else:
        write_stream(file, packets, job_id)


def _evaluate(cell: Cell, order: Order, position: WorkPosition) -> Record:
    position.at("open")
    bench = _workbench()
    sequence = bench.sequence(cell.sequence, order.cache_bytes)
    position.at("construct codec")
    codec: AnyCodec[Any] = bench.create(cell.codec)
    position.at("construct evaluator")
    evaluator: Evaluator[Any] = bench.create(cell.evaluator)
    check = MeasurementCheck(evaluator, len(sequence))
    with tempfile.TemporaryDirectory(prefix="codecbench-cell-") as folder:
        rng, plugins = np.random.default_rng(cell.seed), DeclaredPlugins(bench.registry, evaluator.uses)
        context = Context(rng, cell.repeat, Path(folder), plugins, cell.awaited)
        if isinstance(evaluator, CodecEvaluator):
            position.at("evaluate")
            found = list(check.checked(evaluator.evaluate(codec, sequence, context)))
            noted: tuple[str, ...] = ()
        else:
            assert order.bitstreams is not None
            assert cell.job_id is not None
            file = BitstreamFile(order.bitstreams, cell.job_id)
            coded = CodedFrames(sequence, codec, file, position, bench.pictures(file, order.cache_bytes))
            found = list(_of_coded(evaluator, coded, context, check, position))
            noted = coded.notes
        position.at("remark")
        notes = (*_remarks(codec), *noted)
        position.at("artifacts")
        contents = _artifacts(Path(folder))
    position.at("libraries")
    libraries = _libraries(codec)
    samples = [measurement for measurement in found if measurement.frame is not None]
    if samples:
        contents[SAMPLES_FILE] = parquet_from_samples(samples)
    return Record(
        cell.id,
        "ok",
        measurements=tuple(measurement for measurement in found if measurement.frame is None),
        summaries=summarise(samples, evaluator.metrics),
        metrics=tuple(metric.name for metric in evaluator.metrics),
        libraries=libraries,
        notes=notes,
        contents=contents,
    )


def _of_coded(
    evaluator: Evaluator[Any], coded: CodedFrames, context: Context, check: MeasurementCheck, position: WorkPosition
) -> Iterator[Measurement]:
    """The measurements of an evaluator that looks at coded frames."""
    position.at("evaluate")
    if isinstance(evaluator, SequenceEvaluator):
        yield from check.checked(evaluator.evaluate(coded, context))
    elif isinstance(evaluator, FrameEvaluator):
        for index in range(len(coded)):
            frame = coded.frame(index)
            position.at("evaluate", index)
            yield from check.checked(evaluator.evaluate(frame), index)
    else:
        kinds = "FrameEvaluator, SequenceEvaluator or CodecEvaluator"
        raise PluginError(f"{type(evaluator).__name__} is not a {kinds}; subclass one of them")


def _remarks(codec: AnyCodec[Any]) -> tuple[str, ...]:
    found = codec.remark()
    if not isinstance(found, str):
        raise PluginError(f"remark returned {clean_line(repr(found))}; it returns text")
    return (clean_line(found),) if found else ()


def _libraries(codec: AnyCodec[Any]) -> dict[str, str]:
    found = codec.libraries()
    if not isinstance(found, dict) or not all(isinstance(text, str) for pair in found.items() for text in pair):
        raise PluginError(f"libraries returned {clean_line(repr(found))}; it returns names with their versions")
    return {clean_line(name): clean_line(version) for name, version in found.items()}


def _artifacts(folder: Path) -> dict[str, bytes]:
    files = {}
    for path in sorted(folder.iterdir()):
        if not path.is_file() or path.name in (RECORD_FILE, SAMPLES_FILE) or path.name.startswith("."):
            raise MeasurementError(f"artifact {path.name!r} is a folder or takes a name that the engine uses")
        if path.is_symlink() or not path.name.isprintable():
            raise MeasurementError(f"artifact {path.name!r} is a link or has a name that cannot be printed")
        files[path.name] = path.read_bytes()
    return files
