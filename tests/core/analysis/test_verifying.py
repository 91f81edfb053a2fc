"""Cells of a bundle, computed again: those that were changed are found, and those that cannot be say why."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from codecbench import Measurement, StoreError, bundle, run, verify_run
from codecbench.core.analysis import verification as verifying
from codecbench.core.analysis.verification import Verification
from codecbench.core.engine.identity import canonical_json, content_digest, digest
from codecbench.core.engine.storage.samples import parquet_from_samples, table_from_parquet

pytestmark = pytest.mark.thorough

MATRIX = """
version: 1
name: small
sequences:
  - {use: synthetic, params: {width: 96, height: 64, stop: 2}}
  - {use: folder, params: {path: pictures}}
codecs: [png, {use: jpeg, params: {quality: {grid: [20, 60]}}}]
evaluators: [quality, {use: timing, params: {repeats: 1, frames: 1}}]
run: {workers: 1}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of two sequences, one of which lies in the folder `pictures`."""
    folder = tmp_path_factory.mktemp("verified")
    (folder / "pictures").mkdir()
    for number in range(2):
        image = np.random.default_rng(number).integers(0, 256, (40, 60, 3), np.uint8)
        cv2.imwrite(str(folder / "pictures" / f"{number}.png"), image)
    (folder / "small.yaml").write_text(MATRIX)
    assert not run(folder / "small.yaml", out=folder / "run").failed
    return folder


def verdicts(found: Verification) -> dict[tuple[str, str], str]:
    return {(a.cell.sequence.name, f"{a.cell.codec.name} {a.cell.codec.label}".strip()): a.verdict for a in found.cells}


def test_a_sound_bundle_agrees_to_the_bit(place: Path, tmp_path: Path) -> None:
    path = bundle(place / "run", tmp_path / "b.zip")
    found = verify_run(path, cells=100, workers=1, sequences_from=str(place), out=tmp_path / "again")
    assert found.counts == {"to the bit": 6}
    assert (found.of, found.left_out, found.holds) == (6, 6, True)
    assert all(agreement.values for agreement in found.cells)
    assert (tmp_path / "again" / "plan.json").exists()
    with pytest.raises(StoreError, match="already exists"):
        verify_run(path, out=tmp_path / "again")


def test_files_that_the_plan_names_are_opened_only_when_asked(place: Path, tmp_path: Path) -> None:
    found = verify_run(bundle(place / "run", tmp_path / "b.zip"), cells=100, workers=1)
    assert found.counts == {"to the bit": 3, "not recomputed": 3}
    notes = {a.note for a in found.cells if a.verdict == "not recomputed"}
    assert all("--sequences-from FOLDER" in note for note in notes)
    same = verify_run(tmp_path / "b.zip", cells=100, workers=1, sequences_from="same")
    assert same.counts == {"to the bit": 6}


def test_other_frames_of_the_same_name_are_not_compared(place: Path, tmp_path: Path) -> None:
    shutil.copytree(place / "pictures", tmp_path / "pictures")
    cv2.imwrite(str(tmp_path / "pictures" / "0.png"), np.zeros((40, 60, 3), np.uint8))
    path = bundle(place / "run", tmp_path / "b.zip")
    found = verify_run(path, cells=100, workers=1, sequences_from=str(tmp_path))
    assert found.counts == {"to the bit": 3, "not recomputed": 3}
    assert "different frames here" in next(a.note for a in found.cells if a.verdict == "not recomputed")


def test_a_value_that_somebody_changed_is_found(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was measured of `png` on the rendered frames is a little larger, and every checksum fits."""
    folder = Path(shutil.copytree(place / "run", tmp_path / "changed"))
    (folder / "records" / "index.jsonl").unlink()
    for path in folder.glob("records/*/*/record.json"):
        record = json.loads(path.read_bytes())
        cell = record["cell"]
        if (cell["sequence"]["name"], cell["codec"]["name"], cell["evaluator"]["name"]) == (
            "synthetic",
            "png",
            "quality",
        ):
            rows = table_from_parquet((path.parent / "frames.parquet").read_bytes()).to_pylist()
            samples = [Measurement(**{**row, "value": row["value"] * (1 + 1e-5)}) for row in rows]
            content = parquet_from_samples(samples)
            (path.parent / "frames.parquet").write_bytes(content)
            record["files"]["frames.parquet"] = {"size": len(content), "digest": content_digest(content)}
            del record["checksum"]
            path.write_text(json.dumps({"checksum": digest(record), **record}))
    path = bundle(folder)
    found = verify_run(path, cells=100, workers=1)
    assert found.counts == {"to the bit": 2, "differs": 1, "not recomputed": 3}
    assert not found.holds
    assert verdicts(found)["synthetic", "png"] == "differs"
    again = verify_run(path, cells=100, workers=1, tolerance=1e-4)
    assert again.counts == found.counts, "versions are equal"
    monkeypatch.setattr(verifying, "other_version", lambda *_: "numpy is older there")
    loose = verify_run(path, cells=100, workers=1, tolerance=1e-4)
    assert loose.counts == {"to the bit": 2, "within tolerance": 1, "not recomputed": 3}
    assert loose.holds


def test_what_is_of_another_version_or_not_installed_cannot_be_compared(place: Path, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(place / "run", tmp_path / "older"))
    document = json.loads((folder / "plan.json").read_bytes())
    for setting in document["plan"]["settings"]:
        if setting["name"] == "png":
            setting["version"] = "0"
        if setting["params"].get("quality") == 20:
            setting["name"] = "jpegg"
    body = document["plan"]
    (folder / "plan.json").write_bytes(canonical_json({"checksum": digest(body), "plan": body}))
    notes = {
        a.cell.codec.name: a.note
        for a in verify_run(folder, cells=100, workers=1, sequences_from="same").cells
        if a.note
    }
    assert "its version is" in notes["png"]
    assert "'jpegg'; did you" in notes["jpegg"]
    assert "'jpeg'?" in notes["jpegg"]
