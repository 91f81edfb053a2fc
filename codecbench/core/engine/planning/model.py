"""The nouns of a plan: which settings of which plugins meet on which sequence."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any, Final, Literal

from pydantic import AliasChoices, Field, TypeAdapter

from codecbench.core.contracts.hooks import Kind
from codecbench.core.engine.text import clean_line, clean_text, clean_value


@dataclass(frozen=True)
class PluginSetting:
    """One plugin with one set of parameters, validated.

    params: complete, as JSON types, paths absolute. label: what tells this setting from the others of the
    same plugin in the matrix (`qf=5 levels=2`), empty where it is the only one. uses: the plugins that an evaluator
    runs. inert: names of parameters that cannot change a result, so that they are in no identity. distribution: where
    it comes from, with its version; empty for codecbench's own.
    """

    kind: Kind
    name: str
    version: str
    params: dict[str, Any] = field(default_factory=dict)
    label: str = ""
    uses: tuple[PluginSetting, ...] = ()
    inert: tuple[str, ...] = ()
    distribution: str = ""

    def __hash__(self) -> int:
        return hash((self.kind, self.name, self.version, self.label))

    @property
    def full_name(self) -> str:
        """The plugin with its distribution, as reasons name it."""
        return f"{self.kind.replace('_', ' ')} {self.name} of {self.distribution or 'codecbench'}"

    @property
    def title(self) -> str:
        """What tables call the setting of an evaluator: its name, and its label where it has several settings."""
        return f"{self.name}({self.label})" if self.label else self.name

    def effective_params(self) -> dict[str, Any]:
        """The parameters that can change a result, those at their default among them."""
        return {name: value for name, value in self.params.items() if name not in self.inert}


@dataclass(frozen=True)
class SequenceEntry:
    """A sequence of the matrix, opened once while planning.

    missing: why a plugin's fault kept it from being opened; its fingerprint is then that of its setting.
    notes: what its dataset says of it, in sentences. as_calibrated: as its dataset declares, see `FrameSequence`.
    frame_rate_hz: nominal; 0 where it is not known.
    """

    name: str
    dataset: PluginSetting
    fingerprint: str
    frames: int
    channels: int
    has_camera: bool
    has_ground_truth: bool
    missing: str | None = None
    notes: tuple[str, ...] = ()
    as_calibrated: str = ""
    frame_rate_hz: float = 0.0


@dataclass(frozen=True)
class CodingJob:
    """All frames of a sequence under one codec setting. Its id is the name of its file of bitstreams."""

    id: str
    sequence: SequenceEntry
    codec: PluginSetting

    @property
    def plugins(self) -> tuple[PluginSetting, ...]:
        """Those whose code runs."""
        return self.sequence.dataset, self.codec


@dataclass(frozen=True)
class Cell:
    """One sequence x one codec setting x one evaluator x one repeat.

    id: hash of everything that can change the result. job_id: the coding job whose bitstreams it reads, or
    None for evaluators that run the codec themselves. unsupported: why it cannot be computed, or None. inputs: what
    other cells have measured for it, by the parameter for which that stands.
    """

    id: str
    sequence: SequenceEntry
    codec: PluginSetting
    evaluator: PluginSetting
    repeat: int
    seed: int
    exclusive: bool
    job_id: str | None
    unsupported: str | None = None
    inputs: dict[str, float] = field(default_factory=dict)

    @property
    def plugins(self) -> tuple[PluginSetting, ...]:
        """Those whose code runs."""
        return self.sequence.dataset, self.codec, self.evaluator, *self.evaluator.uses

    def tail(self) -> tuple[Any, ...]:
        """What is the cell's own: its fields after the settings, in order, but its inputs."""
        return self.repeat, self.seed, self.exclusive, self.job_id, self.unsupported


@dataclass(frozen=True)
class RunSettings:
    """The `run:` section of a matrix. None of it can change a result but `seed`, which enters every cell."""

    workers: int
    timeout_s: float
    memory_mb: int
    seed: int
    executor: PluginSetting


SearchState = Literal["under way", "found", "nearest", "unreachable", "stopped"]


@dataclass(frozen=True)
class SearchFinding:
    """What a search has found on a sequence by now.

    objective: the metric and the value that it is to have. setting: the label of the setting that was found, empty if
    none was. reached: its value, None if it has none that is finite. trials: settings that were tried. words: a
    sentence about it. under way: settings are still to be tried; found: this one meets the objective; nearest: no other
    comes nearer; unreachable: none meets it; stopped: a trial failed or has no value, or the budget is spent.
    """

    sequence: str
    codec: str
    objective: Annotated[str, Field(validation_alias=AliasChoices("objective", "aim"))]
    state: SearchState
    setting: str
    reached: float | None
    trials: int
    words: str

    def __str__(self) -> str:
        return f"{self.codec} on {self.sequence}, {self.objective}: {self.words}"


@dataclass(frozen=True)
class Plan:
    """What a matrix asks for, in the order in which tables show it.

    declared: what its plugins said of their meaning when the plan was made; see `planning.declared`. searches: what
    each has found when the plan was last made; see `planning.search`.
    """

    name: str
    matrix_text: str
    run: RunSettings
    sequences: tuple[SequenceEntry, ...]
    jobs: tuple[CodingJob, ...]
    cells: tuple[Cell, ...]
    declared: dict[str, Any] = field(default_factory=dict)
    searches: tuple[SearchFinding, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """The plan as JSON types; `plan_from_json` reads it back.

        Cells name their sequence and settings by position, so that a plan of 100,000 cells stays small.
        """
        settings: dict[PluginSetting, int] = {}
        positions = {entry.name: position for position, entry in enumerate(self.sequences)}

        def position(setting: PluginSetting) -> int:
            return settings.setdefault(setting, len(settings))

        jobs = [[job.id, positions[job.sequence.name], position(job.codec)] for job in self.jobs]
        cells = [
            (cell.id, positions[cell.sequence.name], position(cell.codec), position(cell.evaluator), *cell.tail())
            for cell in self.cells
        ]
        return {
            "name": self.name,
            "matrix_text": self.matrix_text,
            "run": asdict(self.run),
            "sequences": [asdict(entry) for entry in self.sequences],
            "settings": [_json_from_setting(setting) for setting in settings],
            "jobs": jobs,
            "cells": cells,
            "inputs": {cell.id: cell.inputs for cell in self.cells if cell.inputs},
            "declared": self.declared,
            "searches": [asdict(finding) for finding in self.searches],
        }


_Id = Annotated[str, Field(pattern="^[0-9a-f]+$")]
_Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", max_length=255)]
"""Of a matrix; folders are called by it."""

_Declared = dict[str, dict[str, dict[str, Any]]]


@dataclass(frozen=True)
class _PlanBody:
    """What `as_json` writes; texts of one line are cleaned, for the plan may come from elsewhere."""

    name: _Name
    matrix_text: str
    run: RunSettings
    sequences: list[SequenceEntry]
    settings: list[PluginSetting]
    jobs: list[tuple[_Id, int, int]]
    cells: list[tuple[_Id, int, int, int, int, int, bool, _Id | None, str | None]]
    declared: _Declared = field(default_factory=dict)
    searches: list[SearchFinding] = field(default_factory=list)
    inputs: Annotated[dict[_Id, dict[str, float]], Field(validation_alias=AliasChoices("inputs", "awaited"))] = field(
        default_factory=dict
    )


_BODY: Final = TypeAdapter(_PlanBody)


def plan_from_json(value: dict[str, Any]) -> Plan:
    """The plan that `as_json` wrote, its texts fit to be shown. Raises ValueError or IndexError for anything else."""
    body = _BODY.validate_python(value)
    sequences = [_clean_sequence(entry) for entry in body.sequences]
    settings = [_clean_setting(setting) for setting in body.settings]
    return Plan(
        name=body.name,
        matrix_text=clean_text(body.matrix_text),
        run=body.run,
        sequences=tuple(sequences),
        jobs=tuple(CodingJob(id_, sequences[at], settings[codec]) for id_, at, codec in body.jobs),
        cells=tuple(
            Cell(
                id_,
                sequences[at],
                settings[codec],
                settings[evaluator],
                repeat,
                seed,
                exclusive,
                job_id,
                unsupported,
                body.inputs.get(id_, {}),
            )
            for id_, at, codec, evaluator, repeat, seed, exclusive, job_id, unsupported in body.cells
        ),
        declared=clean_value(body.declared),
        searches=tuple(SearchFinding(**clean_value(vars(finding))) for finding in body.searches),
    )


def _clean_sequence(entry: SequenceEntry) -> SequenceEntry:
    notes = tuple(clean_line(note) for note in entry.notes)
    return replace(entry, name=clean_line(entry.name), dataset=_clean_setting(entry.dataset), notes=notes)


def _clean_setting(setting: PluginSetting) -> PluginSetting:
    return replace(setting, name=clean_line(setting.name), label=clean_line(setting.label))


def _json_from_setting(setting: PluginSetting) -> dict[str, Any]:
    """The fields of a setting, without the copies that `asdict` makes of each value: plans have 100,000 of them."""
    return {**vars(setting), "uses": [_json_from_setting(used) for used in setting.uses]}
