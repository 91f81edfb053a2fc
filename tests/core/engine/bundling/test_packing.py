"""A bundle holds what was measured, and nothing that is made from it or that belongs to who made it."""

from __future__ import annotations

import hashlib
import json
import os
import zipfile
from pathlib import Path

import pytest
from kept_runs import write_kept_run

from codecbench import StoreError
from codecbench.core.engine.bundling.packing import unpack_bundle, write_bundle
from codecbench.core.engine.storage import folder_lock


@pytest.fixture
def run(tmp_path: Path) -> Path:
    write_kept_run(tmp_path / "run")
    return tmp_path / "run"


def test_it_lies_beside_the_run_and_says_what_it_is(run: Path) -> None:
    made = write_bundle(run)
    assert made.path == run.with_name("run.bundle.zip")
    content = made.path.read_bytes()
    assert (made.size_bytes, made.sha256) == (len(content), hashlib.sha256(content).hexdigest())
    with zipfile.ZipFile(made.path) as archive:
        assert archive.testzip() is None
        manifest = json.loads(archive.read("manifest.json"))
        names = [name for name in archive.namelist() if name != "manifest.json"]
        assert list(manifest["files"]) == names
        for name in names:
            facts = {"size": len(archive.read(name)), "sha256": hashlib.sha256(archive.read(name)).hexdigest()}
            assert manifest["files"][name] == facts
    assert (manifest["name"], manifest["cells"], manifest["statuses"]) == ("kept", 2, {"ok": 2})


def test_what_is_in_it(run: Path) -> None:
    with zipfile.ZipFile(write_bundle(run).path) as archive:
        names = archive.namelist()
        plan = archive.read("plan.json")
    kinds = sorted({Path(name).name if name.startswith("records") else name.split("/")[0] for name in names})
    assert kinds == [
        "environment", "frames.parquet", "manifest.json", "matrix.yaml", "plan.json", "record.json", "trajectory.txt",
    ]  # fmt: skip
    assert b"seal" not in plan
    assert str(run).encode() not in plan


def test_bitstreams_are_in_it_when_asked_for(run: Path) -> None:
    made = write_bundle(run, bitstreams=True)
    coded = [name for name in made.manifest.files if name.startswith("coded/")]
    assert sorted(Path(name).suffix for name in coded) == [".bits", ".code"]
    assert made.manifest.bitstreams


def test_the_same_run_gives_the_same_bytes(run: Path, tmp_path: Path) -> None:
    first = write_bundle(run, tmp_path / "first.zip", bitstreams=True)
    for path in run.rglob("*"):
        os.utime(path, (1, 1))
    (run / "records" / "index.jsonl").unlink()
    again = write_bundle(run, tmp_path / "again.zip", bitstreams=True)
    assert again.sha256 == first.sha256
    unpack_bundle(first.path, tmp_path / "opened")
    assert write_bundle(tmp_path / "opened", tmp_path / "third.zip", bitstreams=True).sha256 == first.sha256


def test_a_changed_value_gives_other_bytes(run: Path, tmp_path: Path) -> None:
    first = write_bundle(run, tmp_path / "first.zip")
    write_kept_run(tmp_path / "other", note="another note")
    assert write_bundle(tmp_path / "other", tmp_path / "other.zip").sha256 != first.sha256


def test_a_run_that_is_damaged_empty_or_under_way_is_not_bundled(run: Path, tmp_path: Path) -> None:
    with folder_lock.hold_lock(run / "lock"), pytest.raises(StoreError, match="is writing to"):
        write_bundle(run)
    (trajectory, *_) = run.glob("records/*/*/trajectory.txt")
    trajectory.write_bytes(b"changed")
    with pytest.raises(StoreError, match=r"1 damaged .*trajectory\.txt"):
        write_bundle(run)
    write_kept_run(tmp_path / "empty", cells=0)
    with pytest.raises(StoreError, match="no results yet"):
        write_bundle(tmp_path / "empty")
    assert not list(tmp_path.glob("*.zip"))
