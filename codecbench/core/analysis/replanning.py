"""Plans some cells of another run again, with the plugins and sequences of this machine, or says why not."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

from codecbench.core.contracts.errors import CodecbenchError, DatasetError, PluginError
from codecbench.core.contracts.hooks import Kind
from codecbench.core.engine.planning.description import InvalidParams, describe, describe_sequence
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.matrix import Matrix, RunSection
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting, RunSettings, SequenceEntry
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.planning.search import PlanScope
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.storage.plan_file import PlanFile

_Part = TypeVar("_Part")

_OPENING: Final = 10
"""Factor on a plugin's time limit for opening a sequence."""


@dataclass(frozen=True)
class Replanned:
    """A plan made again."""

    plan: Plan
    """The cells that can be computed here."""
    reasons: dict[str, str]
    """Why the others cannot, by their id."""


def replan(original: Plan, cells: Sequence[Cell], sequences_from: str | None, registry: Registry) -> Replanned:
    """Plan these cells of a run that may come from elsewhere.

    Identities are computed from the installed plugins, so that a cell of the same id is the same experiment. Only the
    seed is taken from the other run's settings. Files that its plan names are opened only according to
    `sequences_from`: a folder to search for sequences, or `same` for where the plan names them.
    """
    reader = _Reader(registry, sequences_from)
    sequences = [entry for wanted in _distinct(cell.sequence for cell in cells) if (entry := reader.sequence(wanted))]
    codecs = [codec for setting in _distinct(cell.codec for cell in cells) if (codec := reader.entry(setting))]
    judges = [judge for setting in _distinct(cell.evaluator for cell in cells) if (judge := reader.entry(setting))]
    matrix = Matrix(
        path=Path(original.name), text="", name=original.name, sequences=(), codecs=tuple(codecs),
        evaluators=tuple(judges), run=_run_settings(original.run.seed, registry), root={},
    )  # fmt: skip
    inputs = {(cell.sequence.name, cell.codec, cell.evaluator.title): cell.inputs for cell in cells if cell.inputs}
    extent = PlanScope(inputs=dict(inputs))
    plan = (
        make_plan(matrix, registry, scope=extent, sequences=sequences)
        if sequences
        else replace(original, jobs=(), cells=())
    )
    planned = {cell.id: cell for cell in plan.cells}
    reasons = {cell.id: reason for cell in cells if (reason := reader.reason(cell, planned.get(cell.id)))}
    computable = tuple(planned[cell.id] for cell in cells if cell.id not in reasons)
    job_ids = {cell.job_id for cell in computable}
    return Replanned(
        replace(plan, cells=computable, jobs=tuple(job for job in plan.jobs if job.id in job_ids)), reasons
    )


class _Reader:
    """Finds here what another plan names, and records why not."""

    def __init__(self, registry: Registry, sequences_from: str | None) -> None:
        self.registry, self.sequences_from = registry, sequences_from
        self.missing: dict[str, str] = {}

    def sequence(self, wanted: SequenceEntry) -> SequenceEntry | None:
        """Open the sequence here and check that it has the same frames; None after recording why not."""
        setting, registry = wanted.dataset, self.registry
        try:
            params = self._dataset_params(setting)
            described = describe(registry, "dataset", setting.name, params)
            origin = registry.find("dataset", setting.name).foreign
            plugins: list[tuple[Kind, str]] = [("dataset", setting.name)]
            opened = registry.ask(describe_sequence, setting.name, described.params, of=plugins, times=_OPENING)
            if opened["fingerprint"] != wanted.fingerprint:
                raise DatasetError(f"{wanted.name} has different frames here")
        except (CodecbenchError, InvalidParams, OSError) as error:
            self.missing[wanted.fingerprint] = f"dataset {setting.name}: {error}"
            return None
        dataset = described.setting("dataset", setting.name, origin)
        return SequenceEntry(**{**opened, "name": wanted.name, "dataset": dataset, "notes": tuple(opened["notes"])})

    def entry(self, wanted: PluginSetting) -> Entry | None:
        """Look up the codec or evaluator among the installed plugins; None after recording why not."""
        kind, name, registry = wanted.kind, wanted.name, self.registry
        try:
            self._refuse_files(kind, name, wanted.params)
            described = describe(registry, kind, name, wanted.params)
            for use in described.uses:
                self._refuse_files(*use)
            if described.version != wanted.version:
                raise PluginError(f"its version is {described.version} here and {wanted.version} in the run")
        except (CodecbenchError, InvalidParams, OSError) as error:
            self.missing[_key(wanted)] = f"{kind} {name}: {error}"
            return None
        setting = described.setting(kind, name, registry.find(kind, name).foreign)
        return Entry((), replace(setting, label=wanted.label), description=described, missing=described.missing)

    def reason(self, cell: Cell, planned: Cell | None) -> str | None:
        """Say why a cell cannot be computed here; None if it can. planned: the new plan's cell of its id, if any."""
        if planned is not None:
            return planned.unsupported
        keys = cell.sequence.fingerprint, _key(cell.codec), _key(cell.evaluator)
        known = (self.missing[key] for key in keys if key in self.missing)
        return next(known, "its identity differs here: something that can change the result has changed")

    def _dataset_params(self, setting: PluginSetting) -> dict[str, Any]:
        if self.sequences_from is None:
            self._refuse_files("dataset", setting.name, setting.params)
        if self.sequences_from in (None, SAME_PLACE):
            return setting.params
        return {name: relocate(value, Path(str(self.sequences_from))) for name, value in setting.params.items()}

    def _refuse_files(self, kind: Kind, name: str, params: dict[str, Any]) -> None:
        """Raise DatasetError if parameters name files, unless they may be opened where the plan names them."""
        if self.sequences_from == SAME_PLACE:
            return
        paths = set(self.registry.ask(path_params, kind, name, of=[(kind, name)]))
        values = [value for key, value in params.items() if (key in paths and value is not None) or _has_path(value)]
        if values:
            message = f"the run refers to {values[0]!r}, which is opened only if you allow it"
            remedy = "give --sequences-from FOLDER, or --sequences-from same"
            raise DatasetError(f"{message}: {remedy if kind == 'dataset' else '--sequences-from same'}")


def path_params(registry: Registry, kind: Kind, name: str) -> list[str]:
    """The names of a plugin's parameters that are paths."""
    schema = registry.load(kind, name).params_type.model_json_schema()
    nested = json.dumps(schema.get("$defs", {}))
    texts = {key: json.dumps(value) for key, value in schema.get("properties", {}).items()}
    return [key for key, text in texts.items() if '"path"' in (text + nested if "$ref" in text else text)]


def _has_path(value: Any) -> bool:
    """Whether a JSON value contains a text with a slash."""
    if isinstance(value, str):
        return "/" in value
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(_has_path(part) for part in parts)


def _run_settings(seed: int, registry: Registry) -> RunSettings:
    """The default run settings, with this seed."""
    usual, name = RunSection(), registry.plugins("executor")[0].spec.name
    executor = describe(registry, "executor", name, {}).setting("executor", name, "")
    return RunSettings(usual.workers, usual.timeout_s, usual.memory_mb, seed, executor)


def _key(setting: PluginSetting) -> str:
    return json.dumps([setting.kind, setting.name, setting.version, setting.params, setting.label])


def _distinct(parts: Iterable[_Part]) -> list[_Part]:
    """The parts in order, without repetitions; not all can be hashed, as they hold mappings."""
    seen: list[_Part] = []
    for part in parts:
        if part not in seen:
            seen.append(part)
    return seen


SAME_PLACE: Final = "same"
"""Value of `sequences_from` that opens sequences where the plan names them."""


def openable_params(folder: Path, entry: SequenceEntry, sequences_from: str | None) -> dict[str, Any]:
    """Return the parameters to open a sequence of the run in `folder` with.

    sequences_from: a folder to search for it, or `same` for the plan's paths, even if the run was made elsewhere; None
    opens only what this user's own plan names. Raises DatasetError if it may not be opened.
    """
    if sequences_from not in (None, SAME_PLACE):
        return {name: relocate(value, Path(sequences_from)) for name, value in entry.dataset.params.items()}
    elsewhere = PlanFile(folder).origin_elsewhere() if sequences_from is None else None
    if elsewhere is not None:
        message = f"the run was made in {elsewhere}, so the sequences of its plan are not opened"
        raise DatasetError(f"{message}; give --sequences-from FOLDER, or --sequences-from same")
    return entry.dataset.params


def relocate(value: Any, folder: Path) -> Any:
    """Find a parameter that is a path in `folder`; return others as they are. Raises DatasetError."""
    if not isinstance(value, str) or "/" not in value:
        return value
    home, parts = folder.resolve(), [part for part in Path(value).parts if part not in ("/", "..")]
    for start in range(len(parts)):
        path = home.joinpath(*parts[start:])
        if path.exists() and path.resolve().is_relative_to(home):
            return str(path)
    raise DatasetError(f"{parts[-1] if parts else value} is not in {folder}")
