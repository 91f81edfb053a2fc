"""An evaluator at work on a cell: in the worker where it is codecbench's own, in a host where it is of others."""

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
from codecbench.core.engine.running.workbench import Plugins
from codecbench.core.engine.storage.record import RECORD_FILE, SAMPLES_FILE
from codecbench.core.engine.storage.samples import MeasurementCheck, MeasurementError


@dataclass(frozen=True)
class Measured:
    """What an evaluator made of a cell: what it declares, what it measured, and the files that it left, by name."""

    metrics: tuple[Metric, ...]
    measurements: tuple[Measurement, ...]
    artifacts: dict[str, bytes] = field(default_factory=dict, repr=False)


class Position(Protocol):
    """Where the work has got to."""

    def at(self, stage: str, frame: int | None = None) -> None: ...


def measure(
    evaluator: Evaluator[Any],
    subject: CodedSequence | AnyCodec[Any],
    sequence: FrameSequence,
    cell: Cell,
    plugins: PluginSource,
    position: Position,
) -> Measured:
    """What an evaluator makes of the coded frames, or of the codec, of a cell.

    Raises MeasurementError for what no evaluator may measure or leave, and whatever it raises.
    """
    check = MeasurementCheck(evaluator, len(sequence))
    with tempfile.TemporaryDirectory(prefix="codecbench-cell-") as folder:
        context = Context(np.random.default_rng(cell.seed), cell.repeat, Path(folder), plugins, cell.inputs)
        position.at("evaluate")
        if isinstance(evaluator, CodecEvaluator):
            found = list(check.checked(evaluator.evaluate(subject, sequence, context)))  # type: ignore[arg-type]
        else:
            found = list(_measure_coded(evaluator, subject, context, check, position))  # type: ignore[arg-type]
        position.at("artifacts")
        return Measured(tuple(evaluator.metrics), tuple(found), _artifacts(Path(folder)))


def _measure_coded(
    evaluator: Evaluator[Any], coded: CodedSequence, context: Context, check: MeasurementCheck, position: Position
) -> Iterator[Measurement]:
    """The measurements of an evaluator that looks at coded frames."""
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
        raise MeasurementError(f"artifact {name!r} is a folder or takes a name that the engine uses")
    if "/" in name or not name.isprintable():
        raise MeasurementError(f"artifact {name!r} has a name that cannot be printed or is of another folder")


def measure_in_host(
    bench: Plugins,
    cell: Cell,
    subject: CodedSequence | AnyCodec[Any],
    sequence: FrameSequence,
    plugins: PluginSource,
    position: Position,
) -> Measured:
    """The same by an evaluator of another distribution, which sees nothing of this process but what it asks for."""
    shown = Exposed("sequence", sequence)
    codec = cell.codec if not cell.codec.distribution else Exposed("codec", getattr(subject, "codec", subject))
    given = Exposed("coded", subject, sequence=shown, codec=codec) if cell.job_id is not None else codec
    setting = cell.evaluator
    host = bench.host(setting.distribution, "evaluate", cell.id)
    sources = Exposed("plugins", plugins), Exposed("position", position)
    made, found = host.ask(f"{__name__}:measure_here", setting, given, shown, _facts(cell), *sources)
    bench.check(setting, *made)
    if not isinstance(found, Measured) or not all(isinstance(metric, Metric) for metric in found.metrics):
        raise PluginError(f"evaluate returned {type(found).__name__}")
    checked = MeasurementCheck(found, len(sequence)).checked(found.measurements)  # type: ignore[arg-type]
    for name, content in found.artifacts.items():
        _check_name(str(name), isinstance(content, bytes))
    return replace(found, measurements=tuple(checked))


def _facts(cell: Cell) -> Cell:
    """What an evaluator is told of its cell: nothing of where its frames are."""
    return replace(cell, sequence=replace(cell.sequence, dataset=PluginSetting("dataset", "", "")), job_id=None)


def measure_here(
    setting: PluginSetting,
    subject: Any,
    sequence: FrameSequence,
    cell: Cell,
    plugins: PluginSource,
    position: Position,
) -> tuple[tuple[str, str], Measured]:
    """What `measure` says in this host, after the version of the evaluator and its code."""
    made = create_plugin("evaluator", setting.name, setting.params, int(cell.id[:8], 16))
    subject = _own(subject)
    if hasattr(subject, "facts") and "codec" in subject.facts:
        subject.facts["codec"] = _own(subject.facts["codec"])
    sources = _Plugins(plugins, cell)
    found = measure(made.value, subject, sequence, cell, sources, position)
    return (made.facts["of_version"], made.facts["code"]), found


def _own(codec: Any) -> Any:
    """A codec of codecbench's own is made here; any other is asked where it is."""
    if isinstance(codec, PluginSetting):
        return registry().create("codec", codec.name, codec.params)
    return codec


class _Plugins:
    """Codecbench's own plugins are made here, and all others asked where they are."""

    def __init__(self, source: PluginSource, cell: Cell) -> None:
        self._source, self._own = source, {(use.kind, use.name) for use in cell.evaluator.uses if not use.distribution}

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        if (kind, name) in self._own:
            return registry().create(kind, name, params)
        return self._source.create(kind, name, params)
