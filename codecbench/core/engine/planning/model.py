"""The data model of a plan: which settings of which plugins run on which sequences."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Annotated, Any, Final, Literal

from pydantic import AliasChoices, Field, TypeAdapter

from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.image import Layout
from codecbench.core.engine.text import clean_line, clean_text, clean_value


@dataclass(frozen=True)
class PluginSetting:
    """One plugin with one validated set of parameters."""

    kind: Kind
    name: str
    version: str
    params: dict[str, Any] = field(default_factory=dict)
    """Complete, as JSON types, with absolute paths."""
    label: str = ""
    """Distinguishes it from other settings of its plugin (`qf=5 levels=2`); empty if it is the only one."""
    uses: tuple[PluginSetting, ...] = ()
    """The plugins that an evaluator runs."""
    inert: tuple[str, ...] = ()
    """Names of parameters that cannot change a result and therefore enter no identity."""
    distribution: str = ""
    """The plugin's distribution with its version; empty for codecbench's own."""

    def __hash__(self) -> int:
        return hash((self.kind, self.name, self.version, self.label))

    @property
    def full_name(self) -> str:
        """The plugin with its distribution, for messages."""
        return f"{self.kind.replace('_', ' ')} {self.name} of {self.distribution or 'codecbench'}"

    @property
    def title(self) -> str:
        """An evaluator setting's name in tables: its name, and its label if it has several settings."""
        return f"{self.name}({self.label})" if self.label else self.name

    def effective_params(self) -> dict[str, Any]:
        """Return the parameters that can change a result, including those at their default."""
        return {name: value for name, value in self.params.items() if name not in self.inert}


@dataclass(frozen=True)
class SequenceEntry:
    """A sequence of the matrix, opened once while planning."""

    name: str
    dataset: PluginSetting
    fingerprint: str
    """Digest of its frames; of its setting if it could not be opened."""
    frames: int
    channels: int
    has_camera: bool
    has_ground_truth: bool
    missing: str | None = None
    """Which fault of its plugin prevented opening it, or None."""
    notes: tuple[str, ...] = ()
    """Remarks of its dataset, in sentences."""
    as_calibrated: str = ""
    """As its dataset declares, see `FrameSequence`."""
    frame_rate_hz: float = 0.0
    """Nominal; 0 if unknown."""
    bits: int = 8
    has_depth: bool = False
    """Whether its pixels are distances."""

    @property
    def layout(self) -> Layout:
        """Channels and bits of its frames."""
        return Layout(self.channels, self.bits)


@dataclass(frozen=True)
class CodingJob:
    """All frames of a sequence under one codec setting. Its id is the name of its bitstream file."""

    id: str
    sequence: SequenceEntry
    codec: PluginSetting

    @property
    def plugins(self) -> tuple[PluginSetting, ...]:
        """Settings of the plugins whose code runs."""
        return self.sequence.dataset, self.codec


@dataclass(frozen=True)
class Cell:
    """One sequence x one codec setting x one evaluator x one repeat."""

    id: str
    """Hash of everything that can change the result."""
    sequence: SequenceEntry
    codec: PluginSetting
    evaluator: PluginSetting
    repeat: int
    seed: int
    exclusive: bool
    job_id: str | None
    """The coding job whose bitstreams it reads; None for evaluators that run the codec themselves."""
    unsupported: str | None = None
    """Why it cannot be computed, or None."""
    inputs: dict[str, float] = field(default_factory=dict)
    """Values measured by other cells, by the parameter that they replace."""

    @property
    def plugins(self) -> tuple[PluginSetting, ...]:
        """Settings of the plugins whose code runs."""
        return self.sequence.dataset, self.codec, self.evaluator, *self.evaluator.uses

    def tail(self) -> tuple[Any, ...]:
        """Return the cell's fields after its settings, in order, without its inputs."""
        return self.repeat, self.seed, self.exclusive, self.job_id, self.unsupported


@dataclass(frozen=True)
class RunSettings:
    """The `run:` section of a matrix. Only `seed`, which enters every cell, can change a result."""

    workers: int
    timeout_s: float
    memory_mb: int
    seed: int
    executor: PluginSetting


SearchState = Literal["under way", "found", "nearest", "unreachable", "stopped"]


@dataclass(frozen=True)
class SearchFinding:
    """What a search has found on a sequence so far."""

    sequence: str
    codec: str
    objective: Annotated[str, Field(validation_alias=AliasChoices("objective", "aim"))]
    """The metric and its target value."""
    state: SearchState
    """The state of the search.

    "under way": settings remain to be tried. "found": `setting` meets the objective. "nearest": no other setting comes
    nearer. "unreachable": none meets it. "stopped": a trial failed or has no value, or the budget is spent.
    """
    setting: str
    """Label of the setting that was found; empty if none was."""
    reached: float | None
    """The value at that setting; None if it has no finite one."""
    trials: int
    """Number of settings tried."""
    words: str
    """A sentence about the result."""

    def __str__(self) -> str:
        return f"{self.codec} on {self.sequence}, {self.objective}: {self.words}"


@dataclass(frozen=True)
class Plan:
    """What a matrix asks for, in table order."""

    name: str
    matrix_text: str
    run: RunSettings
    sequences: tuple[SequenceEntry, ...]
    jobs: tuple[CodingJob, ...]
    cells: tuple[Cell, ...]
    declared: dict[str, Any] = field(default_factory=dict)
    """What the plugins declared when the plan was made; see `planning.declared`."""
    searches: tuple[SearchFinding, ...] = ()
    """What each search had found when the plan was last made; see `planning.search`."""

    def as_json(self) -> dict[str, Any]:
        """Return the plan as JSON types; `plan_from_json` reads it back.

        Cells refer to their sequence and settings by position, so that a plan of 100,000 cells stays small.
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
"""Name of a matrix; folders are named after it."""

_Declared = dict[str, dict[str, dict[str, Any]]]


@dataclass(frozen=True)
class _PlanBody:
    """What `as_json` writes. Single-line texts are cleaned, because the plan may come from elsewhere."""

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
    """Read the plan that `as_json` wrote and clean its texts. Raises ValueError or IndexError for anything else."""
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
    """Return the fields of a setting without `asdict`'s copy of each value: plans have 100,000 of them."""
    return {**vars(setting), "uses": [_json_from_setting(used) for used in setting.uses]}
