"""The index of records: lines that are whole are read, and nothing else is."""

from __future__ import annotations

import json
import zlib
from dataclasses import replace
from pathlib import Path

import pytest

from codecbench.core.engine.identity import content_digest, digest
from codecbench.core.engine.plugins.fingerprint import code_digest
from codecbench.core.engine.storage.record import Record, bytes_from_record
from codecbench.core.engine.storage.record_index import IndexEntry, RecordIndex, entry_from_record

ENTRY = IndexEntry("ab" * 16, "failed", "a reason", 0.123457, {"record.json": "d1", "map.npz": "d2"}, "s", "c")


@pytest.fixture
def index(tmp_path: Path) -> RecordIndex:
    return RecordIndex(tmp_path / "index.jsonl")


def line(fields: object) -> bytes:
    """A line as it is kept: CRC-32 in hexadecimal, a blank, JSON."""
    text = json.dumps(fields, separators=(",", ":")).encode()
    return f"{zlib.crc32(text):08x} ".encode() + text + b"\n"


def test_a_line_is_what_its_format_says(index: RecordIndex, tmp_path: Path) -> None:
    index.append(replace(ENTRY, duration_s=0.1234567))
    fields = ["ab" * 16, "failed", "a reason", 0.123457, {"record.json": "d1", "map.npz": "d2"}, "s", "c"]
    assert (tmp_path / "index.jsonl").read_bytes() == line(fields)
    assert index.read() == {ENTRY.cell_id: ENTRY}


def test_any_reason_can_be_kept(index: RecordIndex, tmp_path: Path) -> None:
    index.append(replace(ENTRY, reason="né \ud800"))
    assert (tmp_path / "index.jsonl").read_bytes().isascii()
    assert index.read()[ENTRY.cell_id].reason == "né \\ud800"


def test_the_latest_entry_of_a_cell_counts(index: RecordIndex) -> None:
    other = replace(ENTRY, cell_id="cd" * 16)
    for entry in (ENTRY, other, replace(ENTRY, status="ok", reason="")):
        index.append(entry)
    assert index.read() == {ENTRY.cell_id: replace(ENTRY, status="ok", reason=""), other.cell_id: other}
    index.rewrite([other])
    assert index.read() == {other.cell_id: other}
    index.append(ENTRY)
    assert list(index.read()) == [other.cell_id, ENTRY.cell_id]


def test_a_torn_line_is_closed_off_and_a_whole_one_is_not(index: RecordIndex, tmp_path: Path) -> None:
    path = tmp_path / "index.jsonl"
    path.write_bytes(b"t")
    index.append(ENTRY)
    index.append(ENTRY)
    assert path.read_bytes().count(b"\n") == 3
    assert path.read_bytes().startswith(b"t\n")
    assert list(index.read()) == [ENTRY.cell_id]


def test_every_flipped_bit_of_a_line_costs_that_line(index: RecordIndex, tmp_path: Path) -> None:
    other = replace(ENTRY, cell_id="cd" * 16)
    index.rewrite([ENTRY, other])
    whole = (tmp_path / "index.jsonl").read_bytes()
    first = whole.index(b"\n")
    for position in range(first):
        broken = bytearray(whole)
        broken[position] ^= 1 << position % 7
        (tmp_path / "index.jsonl").write_bytes(bytes(broken))
        assert index.read() == {other.cell_id: other}, f"byte {position}"


@pytest.mark.parametrize(
    "fields",
    [
        ["id", "ok", "", 0.5, {"record.json": "d"}, "s"],
        ["id", "ok", "", 0.5, {"record.json": "d"}, "s", "c", "more"],
        ["id", "ok", "", "soon", {"record.json": "d"}, "s", "c"],
        ["id", "ok", None, 0.5, {"record.json": "d"}, "s", "c"],
        ["id", "ok", "", 0.5, {"record.json": "d", "../up": "d"}, "s", "c"],
        ["id", "ok", "", 0.5, {"map.npz": "d"}, "s", "c"],
        {"cell_id": "id"},
        7,
    ],
)
def test_a_line_of_another_shape_is_left_out_though_its_checksum_is_right(
    fields: object, index: RecordIndex, tmp_path: Path
) -> None:
    (tmp_path / "index.jsonl").write_bytes(line(fields))
    assert index.read() == {}


def test_text_of_a_line_is_cleaned_and_no_file_is_no_entries(index: RecordIndex, tmp_path: Path) -> None:
    assert index.read() == {}
    (tmp_path / "index.jsonl").write_bytes(line(["id", "o\x1bk", "a\nb\x00", 1, {"record.json": "d"}, "s", "c"]))
    (entry,) = index.read().values()
    assert (entry.status, entry.reason, entry.duration_s) == ("o\\x1bk", "a b\\x00", 1.0)


def test_an_entry_says_what_its_record_says() -> None:
    cell = {"codec": {"params": {"q": 1}}, "evaluator": {"params": {}}, "uses": [{"params": {"b": 2}}]}
    record = Record(
        "id", "failed", "why", duration_s=2.5, cell=cell, code={"codec x of y": "z"},
        files={"map.npz": {"size": 3, "digest": "dd"}},
    )  # fmt: skip
    content = bytes_from_record(record)
    assert entry_from_record(record, content) == IndexEntry(
        "id", "failed", "why", 2.5, {"record.json": content_digest(content), "map.npz": "dd"},
        digest([{"q": 1}, {}, {"b": 2}]), code_digest(record.code),
    )  # fmt: skip
