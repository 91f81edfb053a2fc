"""From a matrix to a plan: open the sequences, cross settings with evaluators, and say what cannot be done."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from codecbench.core.contracts.errors import CodecbenchError, PluginError, Unsupported
from codecbench.core.contracts.evaluator import CodecEvaluator, Evaluator, PluginUse
from codecbench.core.contracts.params import Params
from codecbench.core.engine.identity import digest, seed_from, without_defaults
from codecbench.core.engine.planning.declared import declared
from codecbench.core.engine.planning.matrix import Entry, Matrix
from codecbench.core.engine.planning.model import Cell, CodingJob, Plan, PluginSetting, SequenceEntry
from codecbench.core.engine.registry import Registry, installed

RECORD_FORMAT = 1
"""Enters every identity: raised when the meaning of a record changes, so that old ones are recomputed."""


@dataclass(frozen=True)
class _Side:
    """A codec or evaluator setting beside its instance, or why there is none.

    identities: what distinguishes it, without parameters at their default; one for each repeat of an evaluator.
    """

    setting: PluginSetting
    identities: tuple[list[Any], ...]
    instance: Any = None
    missing: str | None = None


def make_plan(matrix: Matrix, registry: Registry | None = None) -> Plan:
    """Everything that a matrix asks for.

    Opens every sequence, so that a missing file is an error now and not in an hour. Combinations that
    cannot be computed here become cells with the reason in `unsupported`. Raises MatrixError, with the
    place in the file, for sequences that cannot be opened.
    """
    registry = registry or installed()
    sequences = _open_sequences(matrix, registry)
    codecs = [_codec_side(entry, registry) for entry in matrix.codecs]
    evaluators = [_evaluator_side(entry, registry) for entry in matrix.evaluators]
    jobs: dict[str, CodingJob] = {}
    cells: dict[str, Cell] = {}
    for sequence in sequences:
        for codec in codecs:
            job = CodingJob(coding_id(sequence, codec.setting), sequence, codec.setting)
            for evaluator in evaluators:
                for cell in _cells(job, codec, evaluator, matrix.run.seed, registry):
                    cells.setdefault(cell.id, cell)
                    if cell.job_id is not None and cell.unsupported is None:
                        jobs.setdefault(job.id, job)
    return Plan(
        name=matrix.name,
        matrix_text=matrix.text,
        run=matrix.run,
        sequences=tuple(sequences),
        jobs=tuple(jobs.values()),
        cells=tuple(cells.values()),
        declared=declared(
            (codec.instance for codec in codecs), ((side.setting.title, side.instance) for side in evaluators)
        ),
    )


def coding_id(sequence: SequenceEntry, codec: PluginSetting) -> str:
    """The identity of a sequence's bitstreams under a codec setting.

    All parameters enter it, those at their default too: no record beside a file of bitstreams says which they were,
    so this name must, and a codec that gained a parameter encodes again when somebody asks for its bitstreams.
    """
    setting = [codec.kind, codec.name, codec.version, codec.effective_params()]
    return digest(["coding", RECORD_FORMAT, sequence.fingerprint, setting])


def _open_sequences(matrix: Matrix, registry: Registry) -> list[SequenceEntry]:
    problems = matrix.problems()
    entries: dict[str, SequenceEntry] = {}
    for entry in matrix.sequences:
        if entry.missing is not None:
            problems.add(entry.where, entry.missing)
            continue
        setting = entry.setting
        try:
            sequence = registry.create("dataset", setting.name, setting.params).open()
        except CodecbenchError as error:
            problems.add(entry.where, str(error))
            continue
        name = entry.name or sequence.name
        if name in entries:
            label = setting.label or setting.name
            name = f"{name} {label}"
        if name in entries:
            problems.add(entry.where, f"another sequence is called {name!r}; give this one a `name`")
            continue
        entries[name] = SequenceEntry(
            name=name,
            dataset=setting,
            fingerprint=sequence.fingerprint,
            frames=len(sequence),
            channels=sequence.channels,
            has_camera=sequence.camera is not None,
            has_ground_truth=sequence.ground_truth is not None,
        )
    problems.raise_any()
    return list(entries.values())


def _codec_side(entry: Entry, registry: Registry) -> _Side:
    setting, params = entry.setting, entry.params
    if params is None:
        return _Side(setting, ([setting.kind, setting.name, setting.version, setting.params],), None, entry.missing)
    told = params.identity()
    setting = replace(setting, inert=_inert(params, [told]))
    identity = [setting.kind, setting.name, setting.version, without_defaults(told, params)]
    instance, missing = _instance(setting, registry)
    return _Side(setting, (identity,), instance, missing)


def _evaluator_side(entry: Entry, registry: Registry) -> _Side:
    setting, params = entry.setting, entry.params
    evaluator, missing = (None, entry.missing) if params is None else _instance(setting, registry)
    if params is None or evaluator is None:
        return _Side(setting, ([setting.name, setting.version, setting.params, 0, []],), None, missing)
    told = [evaluator.repeat_identity(repeat) for repeat in range(evaluator.repeats)]
    uses, used = zip(*(_used(use, registry) for use in evaluator.uses), strict=True) if evaluator.uses else ((), ())
    setting = replace(setting, inert=_inert(params, told), uses=tuple(uses))
    identities = [
        [setting.name, setting.version, without_defaults(of_repeat, params), repeat, list(used)]
        for repeat, of_repeat in enumerate(told)
    ]
    return _Side(setting, tuple(identities), evaluator)


def _instance(setting: PluginSetting, registry: Registry) -> tuple[Any, str | None]:
    """The plugin of a setting, or None and why it cannot be used here."""
    try:
        return registry.create(setting.kind, setting.name, setting.params), None
    except Unsupported as error:
        return None, str(error)


def _used(use: PluginUse, registry: Registry) -> tuple[PluginSetting, list[Any]]:
    """A plugin that an evaluator runs, and its identity; without a version where it is not there."""
    try:
        cls = registry.load(use.kind, use.name)
    except (Unsupported, PluginError):
        return PluginSetting(use.kind, use.name, "", use.params), [use.kind, use.name, None, use.params]
    params = cls.params_type.model_validate(use.params)
    told = params.identity()
    setting = PluginSetting(
        use.kind, use.name, cls.version, params.model_dump(mode="json"), inert=_inert(params, [told])
    )
    return setting, [use.kind, use.name, cls.version, without_defaults(told, params)]


def _inert(params: Params, told: list[dict[str, Any]]) -> tuple[str, ...]:
    """Names of the parameters that a plugin leaves out of what it says distinguishes it, or tells otherwise."""
    full = params.model_dump(mode="json")
    return tuple(
        name for name in full if any(name not in identity or identity[name] != full[name] for identity in told)
    )


def _cells(job: CodingJob, codec: _Side, evaluator: _Side, seed: int, registry: Registry) -> Iterator[Cell]:
    instance: Evaluator[Any] | None = evaluator.instance
    unsupported = _unsupported(job.sequence, codec, evaluator, registry)
    shared = ["cell", RECORD_FORMAT, job.sequence.fingerprint, *codec.identities]
    for repeat, identity in enumerate(evaluator.identities):
        cell_id = digest([*shared, *identity, seed])
        yield Cell(
            id=cell_id,
            sequence=job.sequence,
            codec=codec.setting,
            evaluator=evaluator.setting,
            repeat=repeat,
            seed=seed_from(cell_id, seed),
            exclusive=bool(instance and instance.exclusive),
            job_id=None if isinstance(instance, CodecEvaluator) else job.id,
            unsupported=unsupported,
        )


def _unsupported(sequence: SequenceEntry, codec: _Side, evaluator: _Side, registry: Registry) -> str | None:
    """Why this combination cannot be computed here, or None."""
    for side in (codec, evaluator):
        if side.missing is not None:
            return side.missing
    allowed = codec.instance.capabilities.channels
    if sequence.channels not in allowed:
        wanted = " or ".join("gray" if count == 1 else "colour" for count in allowed)
        return f"codec {codec.setting.name} takes {wanted} frames; {sequence.name} has {sequence.channels} channel(s)"
    if "camera" in evaluator.instance.needs and not sequence.has_camera:
        return f"evaluator {evaluator.setting.name} needs a calibrated camera; {sequence.name} has none"
    if "ground_truth" in evaluator.instance.needs and not sequence.has_ground_truth:
        return f"evaluator {evaluator.setting.name} needs ground truth; {sequence.name} has none"
    for use in evaluator.instance.uses:
        try:
            registry.create(use.kind, use.name, use.params)
        except (Unsupported, PluginError) as error:
            return str(error)
    return None
