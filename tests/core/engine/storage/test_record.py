"""Records as documents: what stands in them, what is refused, and what of them is a cell's identity in words."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import pytest

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.engine.identity import digest
from codecbench.core.engine.planning.model import Cell, PluginSetting, SequenceEntry
from codecbench.core.engine.storage.record import (
    Record,
    RecordDamage,
    bytes_from_record,
    cell_description,
    record_from_bytes,
    settings_digest,
)

RECORD = Record(
    cell_id="ab" * 16,
    status="failed",
    reason="why",
    traceback="line 1\nline 2",
    measurements=(Measurement("ate", math.inf, stage="late"), Measurement("size", 2.0, reason="guess")),
    summaries={("psnr", "", "mean"): -math.inf, ("psnr", "decode", "max"): 0.5},
    metrics=("ate", "psnr"),
    files={"map.npz": {"size": 3, "digest": "dd"}},
    environment="e1",
    libraries={"libx": "1"},
    code={"codec x of y": "f00d"},
    started_utc="2024-06-07T08:09:10.000+00:00",
    duration_s=0.25,
    worker={"pid": 1},
    cell={"codec": {"params": {"q": 1}}, "evaluator": {"params": {}}, "uses": [{"params": {"b": 2}}]},
    contents={"map.npz": b"abc"},
    environment_description={"cpu": "x"},
)


def sealed(body: dict[str, Any]) -> bytes:
    """A document whose checksum is right."""
    return json.dumps({**body, "checksum": digest(body)}).encode()


def body() -> dict[str, Any]:
    """The document of RECORD without its checksum."""
    document: dict[str, Any] = json.loads(bytes_from_record(RECORD))
    del document["checksum"]
    return document


def test_a_document_is_what_its_format_says() -> None:
    """Spelt out by hand, so that records of today are read in years."""
    expected = {
        "cell_id": "ab" * 16,
        "status": "failed",
        "reason": "why",
        "traceback": "line 1\nline 2",
        "measurements": [["ate", "inf", "late", None], ["size", 2.0, None, "guess"]],
        "summaries": [["psnr", "", "mean", "-inf"], ["psnr", "decode", "max", 0.5]],
        "metrics": ["ate", "psnr"],
        "files": {"map.npz": {"size": 3, "digest": "dd"}},
        "environment": "e1",
        "libraries": {"libx": "1"},
        "code": {"codec x of y": "f00d"},
        "started_utc": "2024-06-07T08:09:10.000+00:00",
        "duration_s": 0.25,
        "worker": {"pid": 1},
        "cell": RECORD.cell,
        "schema": 1,
    }
    assert body() == expected
    content = bytes_from_record(RECORD)
    assert json.loads(content)["checksum"] == digest(expected)
    assert content.startswith(b'{\n "checksum": "')
    assert content.endswith(b"\n}\n")


def test_all_of_a_record_comes_back_but_what_is_only_on_its_way() -> None:
    assert record_from_bytes(bytes_from_record(RECORD)) == replace(RECORD, contents={}, environment_description={})
    assert bytes_from_record(replace(RECORD, reason="π")).isascii()
    with pytest.raises(ValueError, match="JSON"):
        bytes_from_record(replace(RECORD, duration_s=math.nan))


def test_a_record_that_says_least_says_nothing() -> None:
    least = Record("id", "ok")
    found = {field.name: getattr(least, field.name) for field in fields(least)[2:]}
    empty: dict[str, Any] = dict.fromkeys(("reason", "traceback", "started_utc"), "")
    empty |= dict.fromkeys(("measurements", "metrics", "notes"), ())
    assert found == {**{name: {} for name in found}, **empty, "environment": None, "duration_s": 0.0}
    assert "contents" not in repr(RECORD)
    assert "environment_description" not in repr(RECORD)
    assert record_from_bytes(bytes_from_record(least)) == least


def put(*path: Any) -> Callable[[dict[str, Any]], None]:
    """Puts the last at the place that the others lead to."""

    def change(document: Any) -> None:
        *way, name, value = path
        for part in way:
            document = document[part]
        document[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (put("cell_id", 7), "cell_id: "),
        (put("status", "fine"), "status: "),
        (put("reason", None), "reason: "),
        (put("measurements", 0, 1, "3"), "measurements.0.1"),
        (put("measurements", 0, 1, "nan"), "measurements.0.1"),
        (put("measurements", 0, ["ate", 1.0, None]), "measurements.0"),
        (put("summaries", 0, ["psnr", None, "mean", 1.0]), "summaries.0.1"),
        (put("metrics", [1]), "metrics.0"),
        (put("files", {"../up": {"size": 1, "digest": "d"}}), "files"),
        (put("files", {".hidden": {"size": 1, "digest": "d"}}), "files"),
        (put("files", {"in/side": {"size": 1, "digest": "d"}}), "files"),
        (put("files", {"": {"size": 1, "digest": "d"}}), "files"),
        (put("files", {"nul\0": {"size": 1, "digest": "d"}}), "files"),
        (put("files", "map.npz", "size", "3"), "files.map.npz.size"),
        (put("environment", 3), "environment: "),
        (put("duration_s", "0.25"), "duration_s: "),
        (put("code", {"x": 1}), "code.x"),
        (put("cell", "codec", {}), "cell.codec.params"),
        (put("cell", "evaluator", {"params": []}), "cell.evaluator.params"),
        (put("cell", "uses", {}), "cell.uses"),
    ],
)
def test_another_shape_is_refused_where_it_is_though_the_checksum_is_right(
    change: Callable[[dict[str, Any]], None], place: str
) -> None:
    document = body()
    record_from_bytes(sealed(document))
    change(document)
    for known_good in (False, True):
        with pytest.raises(RecordDamage) as caught:
            record_from_bytes(sealed(document), known_good=known_good)
        assert str(caught.value).startswith(place)


def test_what_is_no_record_is_refused() -> None:
    for content in (b"", b"[]", b"3", b"{}", b'{"checksum": ""}', b'{"checksum": "", "schema": NaN}', b"\xff"):
        with pytest.raises(RecordDamage, match="not a record"):
            record_from_bytes(content)
    for schema in (0, 2, "1", None):
        with pytest.raises(RecordDamage, match=f"format {schema}; .* 1$"):
            record_from_bytes(sealed({**body(), "schema": schema}))


def test_the_checksum_is_only_taken_on_trust_where_it_was_checked() -> None:
    changed = bytes_from_record(RECORD).replace(b'"why"', b'"who"')
    with pytest.raises(RecordDamage, match="checksum"):
        record_from_bytes(changed)
    assert record_from_bytes(changed, known_good=True).reason == "who"


def test_entries_of_other_versions_are_left_out_or_filled_in() -> None:
    later = {**body(), "mood": "good"}
    later["files"]["map.npz"]["color"] = "red"
    assert record_from_bytes(sealed(later)).reason == "why"
    earlier = body()
    del earlier["metrics"], earlier["code"]
    found = record_from_bytes(sealed(earlier))
    assert (found.metrics, found.code) == ((), {})


def test_text_is_cleaned_as_it_is_read() -> None:
    document = body()
    document |= {"reason": "a\nb\x1b", "traceback": "a\nb\x1b", "code": {"x\x07": "y\x07"}}
    document["summaries"] = [["p\x07", "q\x07", "r\x07", None]]
    found = record_from_bytes(sealed(document))
    assert (found.reason, found.traceback, found.code) == ("a b\\x1b", "a\nb\\x1b", {"x\\x07": "y\\x07"})
    ((key, value),) = found.summaries.items()
    assert key == ("p\\x07", "q\\x07", "r\\x07")
    assert math.isnan(value)


def test_a_description_names_everything_that_entered_the_identity() -> None:
    used = PluginSetting("slam_backend", "tracker", "3", {"depth": 2}, "depth=2")
    cell = Cell(
        "id",
        SequenceEntry("room", PluginSetting("dataset", "folder", "1", {"path": "/x"}, "l"), "f00d", 3, 3, True, True),
        PluginSetting("codec", "jpeg", "2", {"quality": 10}, "quality=10"),
        PluginSetting("evaluator", "trajectory", "4", {"n": 1}, "", (used,)),
        5, 6, False, None,
    )  # fmt: skip
    assert cell_description(cell) == {
        "sequence": {"name": "room", "fingerprint": "f00d"},
        "dataset": {"name": "folder", "version": "1", "params": {"path": "/x"}, "label": "l"},
        "codec": {"name": "jpeg", "version": "2", "params": {"quality": 10}, "label": "quality=10"},
        "evaluator": {"name": "trajectory", "version": "4", "params": {"n": 1}, "label": ""},
        "uses": [
            {"kind": "slam_backend", "name": "tracker", "version": "3", "params": {"depth": 2}, "label": "depth=2"}
        ],
        "repeat": 5,
        "seed": 6,
    }


def test_settings_are_the_parameters_of_all_plugins_of_a_cell() -> None:
    assert settings_digest(RECORD.cell) == digest([{"q": 1}, {}, {"b": 2}])
    assert settings_digest({}) == digest([None, None])
    assert settings_digest({"codec": None, "evaluator": {"params": {"e": 1}}}) == digest([None, {"e": 1}])


def test_notes_stand_in_a_record_only_where_there_are_some() -> None:
    assert "notes" not in body()
    noted = replace(RECORD, notes=("holds back 3 frames", "two\nlines"))
    assert record_from_bytes(bytes_from_record(noted)).notes == ("holds back 3 frames", "two lines")
    assert record_from_bytes(sealed(body())).notes == ()
    with pytest.raises(RecordDamage, match="notes"):
        record_from_bytes(sealed({**body(), "notes": "holds"}))
