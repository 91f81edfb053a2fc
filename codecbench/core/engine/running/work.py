"""What workers do: encode a sequence, compute a cell. Whatever goes wrong here becomes a status and a reason."""

from __future__ import annotations

import functools
import os
import platform
import random
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import numpy as np

from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.errors import CodecbenchError, DatasetError, PluginError, Unsupported
from codecbench.core.contracts.evaluator import (
    CodecEvaluator,
    Context,
    Evaluator,
    FrameEvaluator,
    Measurement,
    PluginUse,
    SequenceEvaluator,
)
from codecbench.core.contracts.executor import Status
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.sequence import Sequence
from codecbench.core.engine.aggregate import summarise
from codecbench.core.engine.environment import describe_environment
from codecbench.core.engine.planning.model import Cell, CodingJob, PluginSetting, SequenceEntry
from codecbench.core.engine.registry import Registry, installed
from codecbench.core.engine.running.coding import CodedFrames, Place, encode_sequence
from codecbench.core.engine.running.frame_cache import MOST_BYTES, CachedSequence, FrameCache
from codecbench.core.engine.storage.atomic import open_whole
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage, BitstreamFile, write_bitstreams
from codecbench.core.engine.storage.record import RECORD_FILE, SAMPLES_FILE, Record, cell_description
from codecbench.core.engine.storage.samples import MeasurementCheck, MeasurementError, parquet_from_samples

T = TypeVar("T")

_OPEN_SEQUENCES: Final = 4


@dataclass(frozen=True)
class CodingOrder:
    """A coding job to do.

    target: where to write the bitstreams; None to send them back. cache_bytes: for frames kept in the worker.
    """

    job: CodingJob
    target: Path | None
    cache_bytes: int = MOST_BYTES


@dataclass(frozen=True)
class CodingDone:
    """How a coding job ended; content: the file of bitstreams where there was no target."""

    status: Status
    reason: str = ""
    traceback: str = ""
    content: bytes | None = field(default=None, repr=False)
    duration_s: float = 0.0


@dataclass(frozen=True)
class CellOrder:
    """A cell to compute. coded: its bitstreams' file, or that file's content, or None if it reads none."""

    cell: Cell
    coded: Path | bytes | None = field(default=None, repr=False)
    cache_bytes: int = MOST_BYTES


@dataclass(frozen=True)
class CellDone:
    """What became of a cell: its record, the files beside it, and where it ran.

    damage: the bitstreams could not be read; there is no result, and they have to be made again.
    """

    record: Record
    files: dict[str, bytes]
    environment: dict[str, Any]
    damage: str | None = None


def prepare_worker() -> None:
    """Load what every cell needs, single-threaded, so that the first one is not slower than the others."""
    import pyarrow
    import pyarrow.parquet

    pyarrow.set_cpu_count(1)
    pyarrow.set_io_thread_count(1)
    _workbench()


def perform_coding(order: CodingOrder) -> CodingDone:
    """Encode all frames of a sequence into one file."""
    begun = time.monotonic()
    done = _attempt(lambda place: _encode(order, place), order.job.id)
    return CodingDone(done.status, done.reason, done.traceback, done.value, time.monotonic() - begun)


def perform_cell(order: CellOrder) -> CellDone:
    """Compute one cell."""
    begun, started = time.monotonic(), datetime.now(UTC)
    done = _attempt(lambda place: _evaluate(order, place), order.cell.id)
    result = done.value or _Result()
    record = Record(
        cell_id=order.cell.id,
        status=done.status,
        reason=done.reason,
        traceback=done.traceback,
        measurements=tuple(result.measurements),
        summaries=result.summaries,
        libraries=result.libraries,
        started_utc=started.isoformat(timespec="milliseconds"),
        duration_s=time.monotonic() - begun,
        worker={"host": platform.node(), "pid": os.getpid()},
        cell=cell_description(order.cell),
    )
    damage = done.reason if isinstance(done.error, BitstreamDamage) else None
    return CellDone(record, result.files, _workbench().environment, damage)


@dataclass
class _Result:
    measurements: list[Measurement] = field(default_factory=list)
    summaries: dict[tuple[str, str, str], float] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    libraries: dict[str, str] = field(default_factory=dict)


@dataclass
class _Attempt(Generic[T]):
    status: Status
    value: T | None = None
    reason: str = ""
    traceback: str = ""
    error: BaseException | None = None


def _attempt(action: Callable[[Place], T], identity: str) -> _Attempt[T]:
    """Do something that may go wrong in any way; say where it did."""
    place = Place()
    _start_afresh(identity)
    try:
        return _Attempt("ok", action(place))
    except BaseException as error:  # noqa: BLE001 - a cell's failure, whatever it is, becomes its record
        status: Status = "unsupported" if isinstance(error, Unsupported) else "failed"
        text = str(error) if isinstance(error, CodecbenchError) else f"{type(error).__name__}: {error}"
        reason = " ".join(f"{place}: {text}".split()) if str(place) else " ".join(text.split())
        trace = "".join(traceback.format_exception(error))
        return _Attempt(status, None, reason, trace, error.with_traceback(None))


def _start_afresh(identity: str) -> None:
    """Undo what an earlier task may have done to the process, so that results do not depend on the order."""
    import cv2

    seed = int(identity[:8], 16)
    cv2.setNumThreads(1)
    cv2.setRNGSeed(seed >> 1)
    random.seed(seed)
    np.random.seed(seed)  # noqa: NPY002 - for code of others that draws from the global generator


class _Workbench:
    """What a worker keeps between tasks: plugins, opened sequences, frames, its own description."""

    def __init__(self) -> None:
        self.registry = installed()
        self.environment = describe_environment(self.registry)
        self._cache = FrameCache()
        self._sequences: dict[str, Sequence] = {}

    def create(self, setting: PluginSetting) -> Any:
        """The plugin of a setting. Raises PluginError where another version of it is installed here."""
        instance = self.registry.create(setting.kind, setting.name, setting.params)
        if instance.version != setting.version:
            message = f"{setting.kind} {setting.name} is version {instance.version} on {platform.node()}"
            raise PluginError(f"{message} and {setting.version} in the plan; install the same version everywhere")
        return instance

    def sequence(self, entry: SequenceEntry, cache_bytes: int) -> Sequence:
        """The sequence, opened once, with frames kept up to `cache_bytes`.

        Raises DatasetError where it is no longer the one that was planned.
        """
        source = self._sequences.pop(entry.fingerprint, None)
        if source is None:
            source = self.create(replace(entry.dataset, params=_located(entry.dataset.params))).open()
            if source.fingerprint != entry.fingerprint or len(source) != entry.frames:
                raise DatasetError(f"{entry.name} has changed since the plan was made; run the matrix again")
        self._sequences[entry.fingerprint] = source
        while len(self._sequences) > _OPEN_SEQUENCES:
            del self._sequences[next(iter(self._sequences))]
        self._cache.limit_bytes = cache_bytes
        return CachedSequence(source, entry.name, self._cache)


def _located(params: dict[str, Any]) -> dict[str, Any]:
    """Parameters with paths as this machine knows them; CODECBENCH_PATHS holds `there=here`, joined as in PATH."""
    places = [one.split("=", 1) for one in os.environ.get("CODECBENCH_PATHS", "").split(os.pathsep) if "=" in one]

    def located(value: Any) -> Any:
        for there, here in places:
            if isinstance(value, str) and (value == there or value.startswith(there.rstrip("/") + "/")):
                return here.rstrip("/") + value[len(there.rstrip("/")) :]
        return value

    return {name: located(value) for name, value in params.items()}


@functools.cache
def _workbench() -> _Workbench:
    return _Workbench()


class _DeclaredPlugins:
    """Creates the plugins that an evaluator declared in `uses`, and no others: they are in the cell's identity."""

    def __init__(self, registry: Registry, uses: tuple[PluginUse, ...]) -> None:
        self._registry = registry
        self._declared = {(use.kind, use.name) for use in uses}

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        if (kind, name) not in self._declared:
            raise PluginError(f"{kind} {name!r} is used but not declared; list it in the evaluator's `uses`")
        return self._registry.create(kind, name, params)


def _encode(order: CodingOrder, place: Place) -> bytes | None:
    place.at("open")
    bench = _workbench()
    sequence = bench.sequence(order.job.sequence, order.cache_bytes)
    codec: Codec[Any] = bench.create(order.job.codec)
    bitstreams = encode_sequence(codec, sequence, place)
    if order.target is None:
        stream = BytesIO()
        write_bitstreams(stream, bitstreams)
        return stream.getvalue()
    with open_whole(order.target) as file:
        write_bitstreams(file, bitstreams)
    return None


def _evaluate(order: CellOrder, place: Place) -> _Result:
    cell, bench = order.cell, _workbench()
    place.at("open")
    sequence = bench.sequence(cell.sequence, order.cache_bytes)
    codec: Codec[Any] = bench.create(cell.codec)
    evaluator: Evaluator[Any] = bench.create(cell.evaluator)
    check = MeasurementCheck(evaluator, len(sequence))
    with tempfile.TemporaryDirectory(prefix="codecbench-cell-") as folder:
        rng, plugins = np.random.default_rng(cell.seed), _DeclaredPlugins(bench.registry, evaluator.uses)
        context = Context(rng, cell.repeat, Path(folder), plugins)
        if isinstance(evaluator, CodecEvaluator):
            place.at("evaluate")
            found = list(check.checked(evaluator.evaluate(codec, sequence, context)))
        else:
            assert order.coded is not None
            coded = CodedFrames(sequence, codec, BitstreamFile(order.coded), place)
            found = list(_of_coded(evaluator, coded, context, check, place))
        place.at("artifacts")
        files = _artifacts(Path(folder))
    samples = [one for one in found if one.frame is not None]
    if samples:
        files[SAMPLES_FILE] = parquet_from_samples(samples)
    own = [one for one in found if one.frame is None]
    return _Result(own, summarise(samples, evaluator.metrics), files, codec.libraries())


def _of_coded(
    evaluator: Evaluator[Any], coded: CodedFrames, context: Context, check: MeasurementCheck, place: Place
) -> Iterator[Measurement]:
    """The measurements of an evaluator that looks at coded frames."""
    place.at("evaluate")
    if isinstance(evaluator, SequenceEvaluator):
        yield from check.checked(evaluator.evaluate(coded, context))
    elif isinstance(evaluator, FrameEvaluator):
        for index in range(len(coded)):
            frame = coded.frame(index)
            place.at("evaluate", index)
            yield from check.checked(evaluator.evaluate(frame), index)
    else:
        kinds = "FrameEvaluator, SequenceEvaluator or CodecEvaluator"
        raise PluginError(f"{type(evaluator).__name__} is not a {kinds}; subclass one of them")


def _artifacts(folder: Path) -> dict[str, bytes]:
    files = {}
    for path in sorted(folder.iterdir()):
        if not path.is_file() or path.name in (RECORD_FILE, SAMPLES_FILE) or path.name.startswith("."):
            raise MeasurementError(f"artifact {path.name!r} is a folder or takes a name that the engine uses")
        files[path.name] = path.read_bytes()
    return files
