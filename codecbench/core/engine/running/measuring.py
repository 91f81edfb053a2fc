"""Run an evaluator on a cell: codecbench's own in the worker, others in a host."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import PluginError
from codecbench.core.contracts.evaluator import (
    CodecEvaluator,
    CodedSequence,
    Context,
    Evaluator,
    FrameEvaluator,
    Measurement,
    PluginSource,
    SequenceEvaluator,
)
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.engine.hosting.channel import Exposed
from codecbench.core.engine.planning.model import Cell, PluginSetting
from codecbench.core.engine.plugins.serving import create_plugin, registry
from codecbench.core.engine.running.workbench import PluginFactory
from codecbench.core.engine.storage.record import RECORD_FILE, SAMPLES_FILE
from codecbench.core.engine.storage.samples import MeasurementCheck, MeasurementError


@dataclass(frozen=True)
class Measured:
    """The result of an evaluator on a cell: declared metrics, measurements, and its files by name."""

    metrics: tuple[Metric, ...]
    measurements: tuple[Measurement, ...]
    artifacts: dict[str, bytes] = field(default_factory=dict, repr=False)


class Position(Protocol):
    """Receives how far the work has got."""

    def at(self, stage: str, frame: int | None = None) -> None: ...


def measure(
    evaluator: Evaluator[Any],
    subject: CodedSequence | AnyCodec[Any],
    sequence: FrameSequence,
    cell: Cell,
    plugins: PluginSource,
    position: Position,
) -> Measured:
    """Run an evaluator on the coded frames, or on the codec, of a cell.

    Raises MeasurementError for invalid measurements or artifacts, and whatever the evaluator raises.
    """
    checks = MeasurementCheck(evaluator, len(sequence))
    with tempfile.TemporaryDirectory(prefix="codecbench-cell-") as folder:
        context = Context(np.random.default_rng(cell.seed), cell.repeat, Path(folder), plugins, cell.inputs)
        position.at("evaluate")
        if isinstance(evaluator, CodecEvaluator):
            measurements = list(checks.check(evaluator.evaluate(subject, sequence, context)))  # type: ignore[arg-type]
        else:
            measurements = list(_measure_coded(evaluator, subject, context, checks, position))  # type: ignore[arg-type]
        position.at("artifacts")
        return Measured(tuple(evaluator.metrics), tuple(measurements), _artifacts(Path(folder)))


def _measure_coded(
    evaluator: Evaluator[Any], coded: CodedSequence, context: Context, checks: MeasurementCheck, position: Position
) -> Iterator[Measurement]:
    """Yield the measurements of an evaluator of coded frames."""
    if isinstance(evaluator, SequenceEvaluator):
        yield from checks.check(evaluator.evaluate(coded, context))
    elif isinstance(evaluator, FrameEvaluator):
        for index in range(len(coded)):
            frame = coded.frame(index)
            position.at("evaluate", index)
            yield from checks.check(evaluator.evaluate(frame), index)
    else:
        kinds = "FrameEvaluator, SequenceEvaluator or CodecEvaluator"
        raise PluginError(f"{type(evaluator).__name__} is not a {kinds}; subclass one of them")


def _artifacts(folder: Path) -> dict[str, bytes]:
    files = {}
    for path in sorted(folder.iterdir()):
        _check_name(path.name, path.is_file())
        if path.is_symlink():
            raise MeasurementError(f"artifact {path.name!r} is a link")
        files[path.name] = path.read_bytes()
    return files


def _check_name(name: str, is_file: bool = True) -> None:
    if not is_file or name in (RECORD_FILE, SAMPLES_FILE) or name.startswith("."):
        raise MeasurementError(f"artifact {name!r} is a folder or has a name that the engine uses")
    if "/" in name or not name.isprintable():
        raise MeasurementError(f"artifact {name!r} has an unprintable name or is in another folder")


def measure_in_host(
    bench: PluginFactory,
    cell: Cell,
    subject: CodedSequence | AnyCodec[Any],
    sequence: FrameSequence,
    plugins: PluginSource,
    position: Position,
) -> Measured:
    """Run an evaluator of another distribution in a host, where it sees only the parts of this process it asks for."""
    exposed_sequence = Exposed("sequence", sequence)
    codec = cell.codec if not cell.codec.distribution else Exposed("codec", getattr(subject, "codec", subject))
    exposed_subject = (
        Exposed("coded", subject, sequence=exposed_sequence, codec=codec) if cell.job_id is not None else codec
    )
    setting = cell.evaluator
    host = bench.host(setting.distribution, "evaluate", cell.id)
    sources = Exposed("plugins", plugins), Exposed("position", position)
    version_and_code, measured = host.ask(
        f"{__name__}:measure_here", setting, exposed_subject, exposed_sequence, _without_paths(cell), *sources
    )
    bench.check(setting, *version_and_code)
    if not isinstance(measured, Measured) or not all(isinstance(metric, Metric) for metric in measured.metrics):
        raise PluginError(f"evaluate returned {type(measured).__name__}")
    checked = MeasurementCheck(measured, len(sequence)).check(measured.measurements)  # type: ignore[arg-type]
    for name, content in measured.artifacts.items():
        _check_name(str(name), isinstance(content, bytes))
    return replace(measured, measurements=tuple(checked))


def _without_paths(cell: Cell) -> Cell:
    """Return a cell without its dataset, so that an evaluator does not learn where the frames are."""
    return replace(cell, sequence=replace(cell.sequence, dataset=PluginSetting("dataset", "", "")), job_id=None)


def measure_here(
    setting: PluginSetting,
    subject: Any,
    sequence: FrameSequence,
    cell: Cell,
    plugins: PluginSource,
    position: Position,
) -> tuple[tuple[str, str], Measured]:
    """Run `measure` in this host; also return the evaluator's version and its code's fingerprint."""
    exposed = create_plugin("evaluator", setting.name, setting.params, int(cell.id[:8], 16))
    subject = _local_codec(subject)
    if hasattr(subject, "facts") and "codec" in subject.facts:
        subject.facts["codec"] = _local_codec(subject.facts["codec"])
    sources = _PluginSource(plugins, cell)
    measured = measure(exposed.value, subject, sequence, cell, sources, position)
    return (exposed.facts["of_version"], exposed.facts["code"]), measured


def _local_codec(codec: Any) -> Any:
    """Create a codec of codecbench's own here; any other is called where it is."""
    if isinstance(codec, PluginSetting):
        return registry().create("codec", codec.name, codec.params)
    return codec


class _PluginSource:
    """Creates codecbench's own plugins here; others are called where they are."""

    def __init__(self, source: PluginSource, cell: Cell) -> None:
        self._source = source
        self._own_plugins = {(use.kind, use.name) for use in cell.evaluator.uses if not use.distribution}

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        if (kind, name) in self._own_plugins:
            return registry().create(kind, name, params)
        return self._source.create(kind, name, params)
