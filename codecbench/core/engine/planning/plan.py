"""Turn a matrix into a plan: open the sequences, cross settings with evaluators, and mark what cannot be computed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from codecbench.core.contracts.errors import CodecbenchError, PluginError, Unsupported
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.image import Layout
from codecbench.core.engine.hosting.host import PluginFault
from codecbench.core.engine.identity import digest, seed_from
from codecbench.core.engine.planning.description import (
    Description,
    InvalidParams,
    describe,
    describe_sequence,
)
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.matrix import Matrix
from codecbench.core.engine.planning.model import Cell, CodingJob, Plan, PluginSetting, SequenceEntry
from codecbench.core.engine.planning.search import ALL_REPEATS, PlanScope
from codecbench.core.engine.plugins.registry import Registry, installed

_OPENING = 10
"""Opening a sequence reads the disk, so it may take this many times longer than other questions to a plugin."""

RECORD_FORMAT = 1
"""Part of every identity. Raise it if the meaning of a record changes, so that old records are recomputed."""


@dataclass(frozen=True)
class _Side:
    """A codec or evaluator setting with its plugin's description, or the reason why it cannot be used."""

    setting: PluginSetting
    identities: tuple[list[Any], ...]
    """Identity without parameters at their default; one per repeat of an evaluator."""
    description: Description | None = None
    missing: str | None = None
    searched: bool = False
    """Whether only a search may add it to the plan."""


def make_plan(
    matrix: Matrix,
    registry: Registry | None = None,
    *,
    scope: PlanScope | None = None,
    sequences: Sequence[SequenceEntry] = (),
) -> Plan:
    """Make the plan of what a matrix asks for so far.

    Opens every sequence, so that a missing file is an error now and not in an hour. Combinations that cannot be
    computed here become cells with the reason in `unsupported`. Raises MatrixError, with the position in the file, for
    sequences that cannot be opened.

    scope: which settings of searches and which repeats belong to the plan; by default no searched settings and all
    repeats. sequences: those of the matrix, if they were opened before.
    """
    registry = registry or installed()
    scope = scope or PlanScope()
    sequences = tuple(sequences) or tuple(_open_sequences(matrix, registry))
    tried_settings = {codec for _, codec, _ in scope.repeats}
    codecs = [_codec_side(entry) for entry in matrix.codecs if entry.search is None or entry.setting in tried_settings]
    evaluators = [_evaluator_side(entry, registry) for entry in matrix.evaluators]
    jobs: dict[str, CodingJob] = {}
    cells: dict[str, Cell] = {}
    for sequence in sequences:
        for codec in codecs:
            job = CodingJob(coding_id(sequence, codec.setting), sequence, codec.setting)
            for evaluator in evaluators:
                key = sequence.name, codec.setting, evaluator.setting.title
                repeats = scope.planned(*key, searched=codec.searched)
                inputs = _inputs(evaluator, scope.inputs.get(key))
                if inputs is None and _unsupported(sequence, codec, evaluator) is None:
                    continue
                for cell in islice(_cells(job, codec, evaluator, matrix.run.seed, inputs), repeats):
                    cells.setdefault(cell.id, cell)
                    if cell.job_id is not None and cell.unsupported is None:
                        jobs.setdefault(job.id, job)
    return Plan(
        name=matrix.name,
        matrix_text=matrix.text,
        run=matrix.run,
        sequences=sequences,
        jobs=tuple(jobs.values()),
        cells=tuple(cells.values()),
        declared={
            "codecs": {
                side.setting.name: _with_anchors(side.description.declared, side.setting.name, matrix.anchors)
                for side in codecs
                if side.description and side.description.declared
            },
            "evaluators": {side.setting.title: side.description.declared for side in evaluators if side.description},
        },
    )


def _with_anchors(declared: dict[str, Any], name: str, anchors: tuple[str, ...] | None) -> dict[str, Any]:
    """Return what a codec declares; if the matrix names anchors, they override its `reference`."""
    if anchors is None or declared.get("reference") == "baseline":
        return declared
    return {**declared, "reference": "anchor" if name in anchors else ""}


def make_sampled_plan(matrix: Matrix) -> Plan:
    """Make a plan with the first setting of each search under every evaluator, to show what a run calls.

    Values that evaluators require are set to 0.
    """
    plan = make_plan(matrix)
    titles = [entry.setting.title for entry in matrix.evaluators]
    firsts = [search.settings[0] for search in matrix.searches]
    sampled = {
        (entry.name, first, title): ALL_REPEATS for entry in plan.sequences for first in firsts for title in titles
    }
    settings = [*(entry.setting for entry in matrix.codecs if entry.search is None), *firsts]
    inputs: dict[tuple[str, PluginSetting, str], dict[str, float] | str] = {
        (entry.name, codec, evaluator.setting.title): dict.fromkeys(evaluator.requires, 0.0)
        for entry in plan.sequences for codec in settings for evaluator in matrix.evaluators if evaluator.requires
    }  # fmt: skip
    scope = PlanScope(sampled, inputs=inputs)
    return make_plan(matrix, scope=scope, sequences=plan.sequences) if sampled or inputs else plan


def coding_id(sequence: SequenceEntry, codec: PluginSetting) -> str:
    """Return the identity of a sequence's bitstreams under a codec setting.

    It includes all parameters, even those at their default: no record beside a bitstream file lists them, so its name
    must. A codec that gains a parameter therefore encodes again.
    """
    setting = [codec.kind, codec.name, codec.version, codec.effective_params()]
    return digest(["coding", RECORD_FORMAT, sequence.fingerprint, setting])


def _open_sequences(matrix: Matrix, registry: Registry) -> list[SequenceEntry]:
    problems = matrix.problems()
    entries: dict[str, SequenceEntry] = {}
    for entry in matrix.sequences:
        try:
            sequence = _open_sequence(entry, registry)
        except CodecbenchError as error:
            problems.add(entry.where, str(error))
            continue
        name = entry.name or sequence.name
        setting = entry.setting
        if name in entries:
            label = setting.label or setting.name
            name = f"{name} {label}"
        if name in entries:
            problems.add(entry.where, f"another sequence is called {name!r}; give this one a different `name`")
            continue
        entries[name] = replace(sequence, name=name)
    problems.raise_any()
    return _reject_duplicate_fingerprints(list(entries.values()))


def _reject_duplicate_fingerprints(entries: list[SequenceEntry]) -> list[SequenceEntry]:
    """Mark sequences of other distributions as unopened if they repeat another sequence's fingerprint."""
    owners: dict[str, SequenceEntry] = {}
    for entry in sorted(entries, key=lambda entry: bool(entry.dataset.distribution)):
        owners.setdefault(entry.fingerprint, entry)
    return [
        entry
        if owners[entry.fingerprint].dataset.distribution == entry.dataset.distribution
        else _unopened_sequence(
            entry.dataset, f"{entry.dataset.full_name}: it has the same fingerprint as {owners[entry.fingerprint].name}"
        )
        for entry in entries
    ]


def _unopened_sequence(dataset: PluginSetting, reason: str) -> SequenceEntry:
    """Return the entry of a sequence that could not be opened because of its plugin's fault."""
    fingerprint = digest(["never opened", dataset.name, dataset.params])
    return SequenceEntry(dataset.name, dataset, fingerprint, 0, 1, False, False, reason)


def _open_sequence(entry: Entry, registry: Registry) -> SequenceEntry:
    """Open an entry's sequence under its own name; a plugin's fault is noted in `missing`."""
    setting, missing = entry.setting, entry.missing
    if missing is None:
        try:
            facts = registry.ask(
                describe_sequence, setting.name, setting.params, of=[("dataset", setting.name)], times=_OPENING
            )
            return SequenceEntry(dataset=setting, **{**facts, "notes": tuple(facts["notes"])})
        except PluginFault as fault:
            missing = str(fault)
    elif not entry.faulty:
        raise Unsupported(missing)
    return _unopened_sequence(setting, missing)


def _codec_side(entry: Entry) -> _Side:
    setting, description, searched = entry.setting, entry.description, entry.search is not None
    prefix = [setting.kind, setting.name, setting.version]
    if description is None:
        return _Side(setting, ([*prefix, setting.params],), None, entry.missing, searched)
    (identity,) = description.identities
    return _Side(setting, ([*prefix, identity],), description, description.missing, searched)


def _evaluator_side(entry: Entry, registry: Registry) -> _Side:
    setting, description = entry.setting, entry.description
    missing = entry.missing if description is None else description.missing
    if description is None or missing is not None:
        return _Side(setting, ([setting.name, setting.version, setting.params, 0, []],), None, missing)
    used = [_used_plugin(*use, registry) for use in description.uses]
    identities = [
        [setting.name, setting.version, of_repeat, repeat, [identity for _, identity, _ in used]]
        for repeat, of_repeat in enumerate(description.identities)
    ]
    owner = f"{setting.full_name}: " if setting.distribution else ""
    reasons = (f"{owner}{reason}" for *_, reason in used if reason is not None)
    setting = replace(setting, uses=tuple(plugin for plugin, *_ in used))
    return _Side(setting, tuple(identities), description, next(reasons, None))


def _used_plugin(
    kind: Kind, name: str, params: dict[str, Any], registry: Registry
) -> tuple[PluginSetting, list[Any], str | None]:
    """Return a plugin that an evaluator runs, its identity, and why it is unavailable; then it has no version."""
    try:
        plugin, description = registry.find(kind, name), describe(registry, kind, name, params)
    except (Unsupported, PluginError, InvalidParams) as error:
        return PluginSetting(kind, name, "", params), [kind, name, None, params], str(error)
    setting = description.setting(kind, name, plugin.foreign)
    return setting, [kind, name, description.version, description.identities[0]], description.missing


def _inputs(evaluator: _Side, inputs: dict[str, float] | str | None) -> dict[str, float] | str | None:
    """Return the inputs of an evaluator's cells, or why they will never be available; None while they are pending."""
    return inputs if evaluator.description is not None and evaluator.description.requires else {}


def _cells(
    job: CodingJob, codec: _Side, evaluator: _Side, seed: int, inputs: dict[str, float] | str | None
) -> Iterator[Cell]:
    description = evaluator.description
    unsupported = _unsupported(job.sequence, codec, evaluator) or (inputs if isinstance(inputs, str) else None)
    shared = ["cell", RECORD_FORMAT, job.sequence.fingerprint, *codec.identities]
    for repeat, identity in enumerate(evaluator.identities):
        cell_id = digest([*shared, *identity, seed, *([inputs] if inputs else [])])
        yield Cell(
            id=cell_id,
            sequence=job.sequence,
            codec=codec.setting,
            evaluator=evaluator.setting,
            repeat=repeat,
            seed=seed_from(cell_id, seed),
            exclusive=bool(description and description.exclusive),
            job_id=None if description and description.runs_codec else job.id,
            unsupported=unsupported,
            inputs=inputs if isinstance(inputs, dict) else {},
        )


def _unsupported(sequence: SequenceEntry, codec: _Side, evaluator: _Side) -> str | None:
    """Return why this combination cannot be computed here, or None."""
    if sequence.missing is not None:
        return sequence.missing
    if codec.description is None or codec.missing is not None:
        return codec.missing
    if evaluator.description is None:
        return evaluator.missing
    layout = sequence.layout
    if list(layout) not in codec.description.layouts:
        accepted = " or ".join(str(Layout(*allowed)) for allowed in codec.description.layouts)
        return f"codec {codec.setting.name} accepts {accepted} frames; those of {sequence.name} are {layout}"
    if layout.bits not in evaluator.description.bits:
        accepted = " or ".join(map(str, evaluator.description.bits))
        return f"evaluator {evaluator.setting.name} reads {accepted}-bit frames; those of {sequence.name} are {layout}"
    if "depth" in evaluator.description.needs and not sequence.has_depth:
        return f"evaluator {evaluator.setting.name} needs depth; the pixels of {sequence.name} are intensities"
    if "camera" in evaluator.description.needs and not sequence.has_camera:
        return f"evaluator {evaluator.setting.name} needs a calibrated camera; {sequence.name} has none"
    if "ground_truth" in evaluator.description.needs and not sequence.has_ground_truth:
        return f"evaluator {evaluator.setting.name} needs ground truth; {sequence.name} has none"
    return evaluator.missing
