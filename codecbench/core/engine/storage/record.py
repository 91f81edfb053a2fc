"""A record: everything that is kept of one cell, as a JSON document with a checksum over itself and its files."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import Annotated, Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError

from codecbench.core.contracts.errors import StoreError
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.executor import Status
from codecbench.core.engine.identity import digest, json_from_bytes
from codecbench.core.engine.planning.model import Cell, PluginSetting
from codecbench.core.engine.storage.samples import (
    json_from_measurement,
    json_from_value,
    measurement_from_json,
    value_from_json,
)
from codecbench.core.engine.text import clean_line, clean_text, clean_value

SCHEMA: Final = 1
RECORD_FILE: Final = "record.json"
SAMPLES_FILE: Final = "frames.parquet"
_TRANSIENT: Final = ("contents", "environment_description")

Summaries = dict[tuple[str, str, str], float]
"""Aggregates over the frames of a cell, by (metric, stage, aggregate)."""


class RecordDamage(StoreError):
    """A record on disk is truncated, changed or from another version; the engine computes its cell again."""


@dataclass(frozen=True)
class Record:
    """What became of a cell; a coding job ends in one too, which is not kept.

    measurements: those that belong to no frame; the others are in the Parquet file, aggregated in
    `summaries`. metrics: names of all that its evaluator declared. files: size and digest of each file beside the
    record. environment: id of the description of where it was computed, None if its worker did not live to tell.
    libraries: the codec's foreign libraries. code: distribution and fingerprint of each plugin that ran, see
    `plugin_code`, and of the codec that wrote the bitstreams. started_utc: ISO 8601. worker: host and process, and the
    distributions of others whose code ran there. cell: what entered its identity, in readable form. notes: what is to
    be known of the codec's setting beside its numbers.

    Only on the way from a worker to the run folder: contents, the files beside the record by name; and
    environment_description, what `environment` is the id of.
    """

    cell_id: str
    status: Status
    reason: str = ""
    traceback: str = ""
    measurements: tuple[Measurement, ...] = ()
    summaries: Summaries = field(default_factory=dict)
    metrics: tuple[str, ...] = ()
    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    environment: str | None = None
    libraries: dict[str, str] = field(default_factory=dict)
    code: dict[str, str] = field(default_factory=dict)
    started_utc: str = ""
    duration_s: float = 0.0
    worker: dict[str, Any] = field(default_factory=dict)
    cell: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    contents: dict[str, bytes] = field(default_factory=dict, repr=False)
    environment_description: dict[str, Any] = field(default_factory=dict, repr=False)


FileName = Annotated[str, Field(pattern=r"^[^./\x00][^/\x00]*$")]
"""Of a file beside a record: in its folder and nowhere else."""

_Value = float | Literal["inf", "-inf"] | None


class _Document(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore")


class _Plugin(_Document):
    params: dict[str, Any]


class _Description(_Document):
    """What readers rely on of a cell's description."""

    codec: _Plugin | None = None
    evaluator: _Plugin | None = None
    uses: list[_Plugin] = []


class _File(_Document):
    size: int
    digest: str


class _Body(_Document):
    """A record as JSON types; entries that a later version may add are left out."""

    cell_id: str
    status: Status
    reason: str
    traceback: str
    measurements: list[Annotated[tuple[str, _Value, str | None, str | None], Strict(False)]]
    summaries: list[Annotated[tuple[str, str, str, _Value], Strict(False)]]
    metrics: list[str] = []
    files: dict[FileName, _File]
    environment: str | None
    libraries: dict[str, Any]
    code: dict[str, str] = {}
    started_utc: str
    duration_s: float
    worker: dict[str, Any]
    cell: _Description
    notes: list[str] = []


def cell_description(cell: Cell) -> dict[str, Any]:
    """What entered the cell's identity, in readable form, so that a record means something on its own."""

    def described(setting: PluginSetting) -> dict[str, Any]:
        return {"name": setting.name, "version": setting.version, "params": setting.params, "label": setting.label}

    return {
        "sequence": {"name": cell.sequence.name, "fingerprint": cell.sequence.fingerprint},
        "dataset": described(cell.sequence.dataset),
        "codec": described(cell.codec),
        "evaluator": described(cell.evaluator),
        "uses": [{"kind": used.kind, **described(used)} for used in cell.evaluator.uses],
        "repeat": cell.repeat,
        "seed": cell.seed,
        **({"inputs": cell.inputs} if cell.inputs else {}),
    }


def settings_digest(description: dict[str, Any]) -> str:
    """The digest of all parameters of the plugins that a cell's description names, those at their default too."""
    named = [description.get("codec") or {}, description.get("evaluator") or {}, *description.get("uses", ())]
    return digest([plugin.get("params") for plugin in named])


def bytes_from_record(record: Record) -> bytes:
    """The record as JSON with a checksum over everything else in it."""
    body = {name: getattr(record, name) for name in record.__dataclass_fields__ if name not in _TRANSIENT}
    if not record.notes:
        del body["notes"]
    body["schema"] = SCHEMA
    body["measurements"] = [json_from_measurement(measurement) for measurement in record.measurements]
    body["summaries"] = [[*key, json_from_value(value)] for key, value in record.summaries.items()]
    document = {"checksum": digest(body), **body}
    return (json.dumps(document, indent=1, ensure_ascii=True, allow_nan=False) + "\n").encode()


def record_from_bytes(content: bytes, *, known_good: bool = False) -> Record:
    """The record that `bytes_from_record` wrote. Raises RecordDamage for anything else.

    known_good: these bytes were already found equal to those that were written, so that the checksum inside
    need not be worked out again.
    """
    try:
        body = json_from_bytes(content)
        checksum, schema = body.pop("checksum"), body["schema"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordDamage(f"not a record: {error}") from error
    if schema != SCHEMA:
        raise RecordDamage(f"written in format {schema}; this version reads {SCHEMA}")
    if not known_good and digest(body) != checksum:
        raise RecordDamage("its checksum does not match its content")
    try:
        _Body.model_validate(body)
    except ValidationError as error:
        first = error.errors()[0]
        raise RecordDamage(f"{'.'.join(map(str, first['loc']))}: {first['msg']}") from error
    known = {name: body[name] for name in _Body.model_fields if name in body}
    known["metrics"] = tuple(body.get("metrics", ()))
    known["notes"] = tuple(map(clean_line, body.get("notes", ())))
    known["measurements"] = tuple(measurement_from_json(row) for row in body["measurements"])
    known["summaries"] = {
        (clean_line(metric), clean_line(stage), clean_line(how)): value_from_json(value)
        for metric, stage, how, value in body["summaries"]
    }
    known["code"] = clean_value(body.get("code", {}))
    known["reason"], known["traceback"] = clean_line(body["reason"]), clean_text(body["traceback"])
    return Record(**known)
