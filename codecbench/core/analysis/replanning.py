"""A plan of some cells of another run, made of what is installed and lies here, or why that cannot be."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, TypeVar

from codecbench.core.contracts.errors import CodecbenchError, DatasetError, PluginError
from codecbench.core.contracts.hooks import Kind
from codecbench.core.engine.planning.description import InvalidParams, describe, sequence_described
from codecbench.core.engine.planning.entry import Entry
from codecbench.core.engine.planning.matrix import Matrix, RunSection
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting, RunSettings, SequenceEntry
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.planning.search import PlanScope
from codecbench.core.engine.plugins.registry import Registry

_Part = TypeVar("_Part")

_OPENING: Final = 10
"""Opening a sequence may take so many times what other questions to a plugin may."""


@dataclass(frozen=True)
class Replanned:
    """plan: the cells that can be computed here. reasons: why others cannot, by their id."""

    plan: Plan
    reasons: dict[str, str]


def replanned(found: Plan, cells: Sequence[Cell], sequences_from: str | None, registry: Registry) -> Replanned:
    """The plan of these cells of a run that may come from elsewhere.

    Identities are made anew from what is installed, so that a cell of the same id is the same experiment. Nothing of
    the other run decides how this one is run but its seed. Files that its plan names are opened only as
    `sequences_from` says: a folder in which sequences are looked for, or `same` for where the plan names them.
    """
    reader = _Reader(registry, sequences_from)
    sequences = [entry for wanted in _distinct(cell.sequence for cell in cells) if (entry := reader.sequence(wanted))]
    codecs = [codec for setting in _distinct(cell.codec for cell in cells) if (codec := reader.entry(setting))]
    judges = [judge for setting in _distinct(cell.evaluator for cell in cells) if (judge := reader.entry(setting))]
    matrix = Matrix(
        path=Path(found.name), text="", name=found.name, sequences=(), codecs=tuple(codecs), evaluators=tuple(judges),
        run=_run_settings(found.run.seed, registry), root={},
    )  # fmt: skip
    inputs = {(cell.sequence.name, cell.codec, cell.evaluator.title): cell.inputs for cell in cells if cell.inputs}
    extent = PlanScope(inputs=dict(inputs))
    plan = (
        make_plan(matrix, registry, extent=extent, sequences=sequences)
        if sequences
        else replace(found, jobs=(), cells=())
    )
    made = {cell.id: cell for cell in plan.cells}
    reasons = {cell.id: reason for cell in cells if (reason := reader.reason(cell, made.get(cell.id)))}
    kept = tuple(made[cell.id] for cell in cells if cell.id not in reasons)
    wanted = {cell.job_id for cell in kept}
    return Replanned(replace(plan, cells=kept, jobs=tuple(job for job in plan.jobs if job.id in wanted)), reasons)


class _Reader:
    """Finds here what another plan names, and keeps why it could not."""

    def __init__(self, registry: Registry, sequences_from: str | None) -> None:
        self.registry, self.sequences_from = registry, sequences_from
        self.missing: dict[str, str] = {}

    def sequence(self, wanted: SequenceEntry) -> SequenceEntry | None:
        """The sequence, opened here and found to have the same frames; None after noting why not."""
        setting, registry = wanted.dataset, self.registry
        try:
            params = self._dataset_params(setting)
            described = describe(registry, "dataset", setting.name, params)
            origin = registry.find("dataset", setting.name).foreign
            asked: list[tuple[Kind, str]] = [("dataset", setting.name)]
            found = registry.ask(sequence_described, setting.name, described.params, of=asked, times=_OPENING)
            if found["fingerprint"] != wanted.fingerprint:
                raise DatasetError(f"{wanted.name} has other frames here")
        except (CodecbenchError, InvalidParams, OSError) as error:
            self.missing[wanted.fingerprint] = f"dataset {setting.name}: {error}"
            return None
        dataset = described.setting("dataset", setting.name, origin)
        return SequenceEntry(**{**found, "name": wanted.name, "dataset": dataset, "notes": tuple(found["notes"])})

    def entry(self, wanted: PluginSetting) -> Entry | None:
        """The codec or evaluator as it is installed; None after noting why it is not to be had."""
        kind, name, registry = wanted.kind, wanted.name, self.registry
        try:
            self._refuse_files(kind, name, wanted.params)
            described = describe(registry, kind, name, wanted.params)
            for use in described.uses:
                self._refuse_files(*use)
            if described.version != wanted.version:
                raise PluginError(f"it is version {described.version} here, and {wanted.version} in the run")
        except (CodecbenchError, InvalidParams, OSError) as error:
            self.missing[_key(wanted)] = f"{kind} {name}: {error}"
            return None
        setting = described.setting(kind, name, registry.find(kind, name).foreign)
        return Entry((), replace(setting, label=wanted.label), description=described, missing=described.missing)

    def reason(self, cell: Cell, made: Cell | None) -> str | None:
        """Why a cell cannot be computed here, None where it can. made: the cell of its id, where there is one."""
        if made is not None:
            return made.unsupported
        keys = cell.sequence.fingerprint, _key(cell.codec), _key(cell.evaluator)
        known = (self.missing[key] for key in keys if key in self.missing)
        return next(known, "its identity is another one here: something that can change the result is not as it was")

    def _dataset_params(self, setting: PluginSetting) -> dict[str, Any]:
        if self.sequences_from is None:
            self._refuse_files("dataset", setting.name, setting.params)
        if self.sequences_from in (None, SAME_PLACE):
            return setting.params
        return {name: relocated(value, Path(str(self.sequences_from))) for name, value in setting.params.items()}

    def _refuse_files(self, kind: Kind, name: str, params: dict[str, Any]) -> None:
        """Raise DatasetError where parameters name files, unless those may be opened where the plan names them."""
        if self.sequences_from == SAME_PLACE:
            return
        paths = set(self.registry.ask(path_params, kind, name, of=[(kind, name)]))
        named = [value for key, value in params.items() if (key in paths and value is not None) or _has_path(value)]
        if named:
            message = f"the run names {named[0]!r}, which is opened only when you say so"
            remedy = "give --sequences-from FOLDER, or --sequences-from same"
            raise DatasetError(f"{message}: {remedy if kind == 'dataset' else '--sequences-from same'}")


def path_params(registry: Registry, kind: Kind, name: str) -> list[str]:
    """The names of a plugin's parameters that are paths."""
    schema = registry.load(kind, name).params_type.model_json_schema()
    nested = json.dumps(schema.get("$defs", {}))
    texts = {key: json.dumps(value) for key, value in schema.get("properties", {}).items()}
    return [key for key, text in texts.items() if '"path"' in (text + nested if "$ref" in text else text)]


def _has_path(value: Any) -> bool:
    """Whether a value of JSON has a text with a slash somewhere."""
    if isinstance(value, str):
        return "/" in value
    parts = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return any(_has_path(part) for part in parts)


def _run_settings(seed: int, registry: Registry) -> RunSettings:
    """How to run when nothing is said, with this seed."""
    usual, name = RunSection(), registry.plugins("executor")[0].spec.name
    executor = describe(registry, "executor", name, {}).setting("executor", name, "")
    return RunSettings(usual.workers, usual.timeout_s, usual.memory_mb, seed, executor)


def _key(setting: PluginSetting) -> str:
    return json.dumps([setting.kind, setting.name, setting.version, setting.params, setting.label])


def _distinct(parts: Iterable[_Part]) -> list[_Part]:
    """The parts in order, each once; they hold mappings, so that they cannot all be hashed."""
    seen: list[_Part] = []
    for part in parts:
        if part not in seen:
            seen.append(part)
    return seen


SAME_PLACE: Final = "same"
"""Says that sequences are opened where the plan names them."""


def relocated(value: Any, folder: Path) -> Any:
    """A parameter that is a path, as it is called in `folder`; others as they are. Raises DatasetError."""
    if not isinstance(value, str) or "/" not in value:
        return value
    home, parts = folder.resolve(), [part for part in Path(value).parts if part not in ("/", "..")]
    for start in range(len(parts)):
        path = home.joinpath(*parts[start:])
        if path.exists() and path.resolve().is_relative_to(home):
            return str(path)
    raise DatasetError(f"{parts[-1] if parts else value} is not in {folder}")
