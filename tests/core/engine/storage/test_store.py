"""The run folder: what is written comes back, what is damaged is told, and large ones stay quick."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import pytest

from codecbench.core.contracts.errors import StoreError
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.engine.identity import digest
from codecbench.core.engine.storage.record import Record, RecordDamage, bytes_from_record, record_from_bytes
from codecbench.core.engine.storage.record_index import RecordIndex, entry_from_record
from codecbench.core.engine.storage.samples import parquet_from_samples, table_from_parquet
from codecbench.core.engine.storage.store import Store

RECORD = Record(
    cell_id="ab" * 16,
    status="ok",
    measurements=(
        Measurement("ate_m", 0.1 + 0.2),
        Measurement("psnr_db", math.inf, stage="decode"),
        Measurement("loops", math.nan, reason="none closed"),
    ),
    summaries={("psnr_db", "", "mean"): 1 / 3, ("psnr_db", "decode", "min"): -math.inf},
    environment="e1",
    libraries={"libjpeg-turbo": "3.1"},
    started_utc="2024-06-07T08:09:10.000+00:00",
    duration_s=0.25,
    worker={"pid": 1, "host": "here"},
    cell={"repeat": 0},
)


def test_a_record_comes_back_as_it_was() -> None:
    again = record_from_bytes(bytes_from_record(RECORD))
    assert again.measurements[:2] == RECORD.measurements[:2]
    assert math.isnan(again.measurements[2].value)
    assert again.measurements[2].reason == "none closed"
    assert replace(again, measurements=()) == replace(RECORD, measurements=())


def test_no_change_of_a_record_goes_unnoticed() -> None:
    content = bytes_from_record(RECORD)
    meaning = record_from_bytes(content)
    for position in range(len(content)):
        broken = bytearray(content)
        broken[position] ^= 1
        try:
            found = record_from_bytes(bytes(broken))
        except RecordDamage:
            continue
        assert repr(found) == repr(meaning), f"byte {position} changed the record unseen"
    with pytest.raises(RecordDamage, match=r"format 2; .*reads 1"):
        record_from_bytes(content.replace(b'"schema": 1', b'"schema": 2'))


def test_samples_come_back_in_order() -> None:
    samples = [
        Measurement("psnr_db", math.inf, frame=0),
        Measurement("psnr_db", math.nan, frame=1, reason="black"),
        Measurement("time_ms", 1.5, frame=0, stage="encode"),
    ]
    rows = table_from_parquet(parquet_from_samples(samples)).to_pylist()
    assert [(row["metric"], row["frame"], row["stage"], row["reason"]) for row in rows] == [
        ("psnr_db", 0, None, None),
        ("psnr_db", 1, None, "black"),
        ("time_ms", 0, "encode", None),
    ]
    assert rows[0]["value"] == math.inf
    assert math.isnan(rows[1]["value"])
    assert rows[2]["value"] == 1.5


def test_a_record_is_replaced_whole(tmp_path: Path) -> None:
    store = Store(tmp_path / "run")
    with store.locked():
        store.write_record(replace(RECORD, status="failed", reason="first", contents={"old.txt": b"old"}))
        store.write_record(replace(RECORD, contents={"new.txt": b"new"}))
    record = store.read_record(RECORD.cell_id)
    assert list(record.files) == ["new.txt"]
    assert store.read_file(record, "new.txt") == b"new"
    assert sorted(path.name for path in store.record_folder(RECORD.cell_id).iterdir()) == ["new.txt", "record.json"]
    assert store.entries()[RECORD.cell_id].status == "ok"
    with pytest.raises(StoreError, match=f"record of cell {'cd' * 16}"):
        store.read_record("cd" * 16)


def test_what_an_interrupted_writer_left_is_swept(tmp_path: Path) -> None:
    store = Store(tmp_path / "run")
    with store.locked():
        store.write_record(RECORD)
    rests = [store.coded_folder / ".new-x", store.records_folder / "ab" / ".new-y"]
    rests[0].write_bytes(b"half")
    rests[1].mkdir()
    (rests[1] / "record.json").write_bytes(b"{")
    assert set(store.entries()) == {RECORD.cell_id}
    with store.locked():
        assert not any(rest.exists() for rest in rests)
    assert set(store.entries()) == {RECORD.cell_id}


def test_a_torn_line_of_the_index_costs_nothing(tmp_path: Path) -> None:
    index = RecordIndex(tmp_path / "index.jsonl")
    content = bytes_from_record(RECORD)
    first = entry_from_record(RECORD, content)
    index.append(first)
    with open(tmp_path / "index.jsonl", "ab") as stream:
        stream.write(b'01234567 ["torn", "o')
    second = replace(first, cell_id="cd" * 16)
    index.append(second)
    assert index.read() == {first.cell_id: first, second.cell_id: second}


def test_a_record_in_the_wrong_place_is_damage(tmp_path: Path) -> None:
    store = Store(tmp_path / "run")
    with store.locked():
        store.write_record(RECORD)
    store.record_folder(RECORD.cell_id).rename(store.record_folder("abc" + RECORD.cell_id[3:]))
    sound, damaged = store.sound_entries(["abc" + RECORD.cell_id[3:], RECORD.cell_id])
    assert not sound
    assert list(damaged) == ["abc" + RECORD.cell_id[3:]]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_hundred_thousand_records_are_listed_and_checked_in_seconds(tmp_path: Path) -> None:
    store = Store(tmp_path / "run")
    samples = parquet_from_samples([Measurement("psnr_db", float(n), frame=n) for n in range(100)])
    ids = [digest(n) for n in range(100_000)]
    with store.locked():
        for cell_id in ids:
            store.write_record(replace(RECORD, cell_id=cell_id, contents={"frames.parquet": samples}))
    begun = time.process_time()
    assert len(store.entries()) == 100_000
    listed = time.process_time()
    sound, damaged = store.sound_entries(ids)
    checked = time.process_time()
    assert (len(sound), damaged) == (100_000, {})
    assert listed - begun < 5
    assert checked - begun < 15, "resuming, which also lists, has 10 s on an idle machine"
