"""A record: everything that is kept of one cell, as a JSON document with a checksum over itself and its files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

from codecbench.core.contracts.errors import StoreError
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.executor import Status
from codecbench.core.engine.planning.model import Cell, PluginSetting
from codecbench.core.engine.storage.samples import (
    json_from_measurement,
    json_from_value,
    measurement_from_json,
    value_from_json,
)

SCHEMA: Final = 1
RECORD_FILE: Final = "record.json"
SAMPLES_FILE: Final = "frames.parquet"

Summaries = dict[tuple[str, str, str], float]
"""Aggregates over the frames of a cell, by (metric, stage, aggregate)."""


class RecordDamage(StoreError):
    """A record on disk is truncated, changed or from another version; the engine computes its cell again."""


@dataclass(frozen=True)
class Record:
    """What became of a cell.

    measurements: those that belong to no frame; the others are in the Parquet file, aggregated in
    `summaries`. files: size and digest of each file beside the record. environment: id of the description of
    where it was computed, None if its worker did not live to tell. libraries: the codec's foreign libraries.
    started_utc: ISO 8601. worker: host and process.
    """

    cell_id: str
    status: Status
    reason: str = ""
    traceback: str = ""
    measurements: tuple[Measurement, ...] = ()
    summaries: Summaries = field(default_factory=dict)
    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    environment: str | None = None
    libraries: dict[str, str] = field(default_factory=dict)
    started_utc: str = ""
    duration_s: float = 0.0
    worker: dict[str, Any] = field(default_factory=dict)
    cell: dict[str, Any] = field(default_factory=dict)

    def in_environment(self, environment: str) -> Record:
        """The record with the id of the environment that it was computed in."""
        return replace(self, environment=environment)

    @property
    def artifacts(self) -> list[str]:
        """Names of the files that the evaluator left, in alphabetical order."""
        return sorted(set(self.files) - {SAMPLES_FILE})


def cell_description(cell: Cell) -> dict[str, Any]:
    """What entered the cell's identity, in readable form, so that a record means something on its own."""

    def setting(one: PluginSetting) -> dict[str, Any]:
        return {"name": one.name, "version": one.version, "params": one.params, "label": one.label}

    return {
        "sequence": {"name": cell.sequence.name, "fingerprint": cell.sequence.fingerprint},
        "dataset": setting(cell.sequence.dataset),
        "codec": setting(cell.codec),
        "evaluator": setting(cell.evaluator),
        "repeat": cell.repeat,
        "seed": cell.seed,
    }


def file_facts(files: Mapping[str, bytes]) -> dict[str, dict[str, Any]]:
    """Size and digest of each file, as a record lists them."""
    return {name: {"size": len(content), "digest": content_digest(content)} for name, content in files.items()}


def content_digest(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=16).hexdigest()


def bytes_from_record(record: Record) -> bytes:
    """The record as JSON with a checksum over everything else in it."""
    body = {name: getattr(record, name) for name in record.__dataclass_fields__}
    body["schema"] = SCHEMA
    body["measurements"] = [json_from_measurement(one) for one in record.measurements]
    body["summaries"] = [[*key, json_from_value(value)] for key, value in record.summaries.items()]
    text = _canonical(body)
    document = {"checksum": content_digest(text.encode()), **body}
    return (json.dumps(document, indent=1, ensure_ascii=True, allow_nan=False) + "\n").encode()


def record_from_bytes(content: bytes, *, known_good: bool = False) -> Record:
    """The record that `bytes_from_record` wrote. Raises RecordDamage for anything else.

    known_good: these bytes were already found equal to those that were written, so that the checksum inside
    need not be worked out again.
    """
    try:
        body = json.loads(content)
        checksum, schema = body.pop("checksum"), body["schema"]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise RecordDamage(f"not a record: {error}") from error
    if schema != SCHEMA:
        raise RecordDamage(f"written in format {schema}; this version reads {SCHEMA}")
    if not known_good and content_digest(_canonical(body).encode()) != checksum:
        raise RecordDamage("its checksum does not match its content")
    del body["schema"]
    body["measurements"] = tuple(measurement_from_json(row) for row in body["measurements"])
    body["summaries"] = {(m, stage, how): value_from_json(v) for m, stage, how, v in body["summaries"]}
    return Record(**body)


def _canonical(body: dict[str, Any]) -> str:
    return json.dumps(body, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)
