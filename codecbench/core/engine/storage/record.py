"""A record: everything stored about one cell, as a JSON document with a checksum over itself and its files."""

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
    """Raised for a truncated, changed or incompatible record; the engine computes its cell again."""


@dataclass(frozen=True)
class Record:
    """The result of a cell. A coding job also ends in one, which is not stored."""

    cell_id: str
    status: Status
    reason: str = ""
    traceback: str = ""
    measurements: tuple[Measurement, ...] = ()
    """Measurements that belong to no frame; the others are in the Parquet file, aggregated in `summaries`."""
    summaries: Summaries = field(default_factory=dict)
    metrics: tuple[str, ...] = ()
    """Names of all metrics that the evaluator declared."""
    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Size and digest of each file beside the record."""
    environment: str | None = None
    """Id of the environment it was computed in; None if its worker died."""
    libraries: dict[str, str] = field(default_factory=dict)
    """The codec's third-party libraries with their versions."""
    code: dict[str, str] = field(default_factory=dict)
    """Distribution and fingerprint of each plugin that ran (`code_of`), and of the encoder of the bitstreams."""
    started_utc: str = ""
    """ISO 8601."""
    duration_s: float = 0.0
    worker: dict[str, Any] = field(default_factory=dict)
    """Host, process id, and what confined other distributions' code, if anything did."""
    cell: dict[str, Any] = field(default_factory=dict)
    """What entered the cell's identity, in readable form."""
    notes: tuple[str, ...] = ()
    """Remarks on the codec's setting."""
    contents: dict[str, bytes] = field(default_factory=dict, repr=False)
    """The files beside the record by name; only on the way from a worker to the run folder."""
    environment_description: dict[str, Any] = field(default_factory=dict, repr=False)
    """The description behind `environment`; only on the way from a worker to the run folder."""


FileName = Annotated[str, Field(pattern=r"^[^./\x00][^/\x00]*$")]
"""Name of a file beside a record: in its folder and nowhere else."""

_Value = float | Literal["inf", "-inf"] | None


class _Document(BaseModel):
    model_config = ConfigDict(strict=True, extra="ignore")


class _Plugin(_Document):
    params: dict[str, Any]


class _Description(_Document):
    """The parts of a cell's description that readers rely on."""

    codec: _Plugin | None = None
    evaluator: _Plugin | None = None
    uses: list[_Plugin] = []


class _File(_Document):
    size: int
    digest: str


class _Body(_Document):
    """A record as JSON types; entries that a later version adds are ignored."""

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
    """Return what entered the cell's identity, in readable form, so that a record is meaningful on its own."""

    def setting_fields(setting: PluginSetting) -> dict[str, Any]:
        return {"name": setting.name, "version": setting.version, "params": setting.params, "label": setting.label}

    return {
        "sequence": {"name": cell.sequence.name, "fingerprint": cell.sequence.fingerprint},
        "dataset": setting_fields(cell.sequence.dataset),
        "codec": setting_fields(cell.codec),
        "evaluator": setting_fields(cell.evaluator),
        "uses": [{"kind": used.kind, **setting_fields(used)} for used in cell.evaluator.uses],
        "repeat": cell.repeat,
        "seed": cell.seed,
        **({"inputs": cell.inputs} if cell.inputs else {}),
    }


def settings_digest(description: dict[str, Any]) -> str:
    """Return the digest of all parameters, including defaults, of the plugins in a cell's description."""
    plugins = [description.get("codec") or {}, description.get("evaluator") or {}, *description.get("uses", ())]
    return digest([plugin.get("params") for plugin in plugins])


def bytes_from_record(record: Record) -> bytes:
    """Return the record as JSON with a checksum over everything else in it."""
    body = {name: getattr(record, name) for name in record.__dataclass_fields__ if name not in _TRANSIENT}
    if not record.notes:
        del body["notes"]
    body["schema"] = SCHEMA
    body["measurements"] = [json_from_measurement(measurement) for measurement in record.measurements]
    body["summaries"] = [[*key, json_from_value(value)] for key, value in record.summaries.items()]
    document = {"checksum": digest(body), **body}
    return (json.dumps(document, indent=1, ensure_ascii=True, allow_nan=False) + "\n").encode()


def record_from_bytes(content: bytes, *, known_good: bool = False) -> Record:
    """Read the record that `bytes_from_record` wrote. Raises RecordDamage for anything else.

    known_good: whether the content's digest was already checked, so that the checksum inside need not be.
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
    fields = {name: body[name] for name in _Body.model_fields if name in body}
    fields["metrics"] = tuple(body.get("metrics", ()))
    fields["notes"] = tuple(map(clean_line, body.get("notes", ())))
    fields["measurements"] = tuple(measurement_from_json(row) for row in body["measurements"])
    fields["summaries"] = {
        (clean_line(metric), clean_line(stage), clean_line(aggregate)): value_from_json(value)
        for metric, stage, aggregate, value in body["summaries"]
    }
    fields["code"] = clean_value(body.get("code", {}))
    fields["reason"], fields["traceback"] = clean_line(body["reason"]), clean_text(body["traceback"])
    return Record(**fields)
