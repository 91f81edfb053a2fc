"""Run folders and bitstreams that earlier versions wrote are opened, shown and decoded as then.

`tests/golden/kept/README.md` says how they were made. What a version wrote stays as it is; a version that writes
another format adds its own.
"""

from __future__ import annotations

import base64
import hashlib
import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from project import GOLDEN

from codecbench.core.analysis.collect import open_run
from codecbench.core.conformance.corpus import Entry, pixels_sha256, read_manifest
from codecbench.core.conformance.harness import decoded_of
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.stream import Packet
from codecbench.core.engine.planning.model import CodingJob
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage, BitstreamFile
from codecbench.core.engine.storage.store import Store
from codecbench.core.report.tables import export_table

KEPT = GOLDEN / "kept"
RUNS = sorted(path.name for path in KEPT.glob("run-*"))
OWN = {"raw", "jpeg_qf", "multilevel", "rvl"}
"""Codecs whose pixels hang on no library's version."""


def test_there_are_runs_of_every_format_and_they_are_small() -> None:
    assert RUNS == ["run-1", "run-2"]
    assert sum(path.stat().st_size for path in KEPT.rglob("*") if path.is_file()) < 500_000


@pytest.fixture(params=RUNS)
def kept(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A copy of a kept run folder, with `table.csv` beside it."""
    return Path(shutil.copytree(KEPT / request.param, tmp_path / "kept"))


def test_a_kept_run_is_opened_and_gives_the_table_of_then(kept: Path) -> None:
    result = open_run(kept / "run")
    assert [found.status for found in result.results] == ["ok"] * 14
    assert result.environments
    (kept / "now.csv").write_bytes(export_table(result.wide, "csv"))
    then, now = pd.read_csv(kept / "table.csv"), pd.read_csv(kept / "now.csv")
    assert {
        "codec",
        "setting",
        "quality.rate_bpp.mean",
        "quality.psnr_gray_db.mean",
        "features.inlier_ratio.mean",
    } <= set(then.columns)
    pd.testing.assert_frame_equal(now[list(then.columns)], then)


def test_records_of_a_kept_run_are_whole_to_the_last_byte(kept: Path) -> None:
    store = Store(kept / "run")
    ids = {cell.id for cell in store.read_plan().cells}
    sound, damaged = store.sound_entries(ids)
    assert (set(sound), damaged) == (ids, {})
    assert not store.environments.damaged()


def coded(store: Store, job: CodingJob) -> Iterator[bytes]:
    """The bitstreams of a job; those of the first format, which says not whose they are, by their index."""
    content = store.coded_path(job.id).read_bytes()
    if content[:8] != b"CBBITS\x00\x01":
        file = BitstreamFile(content, job.id)
        yield from (file.read(index) for index in range(len(file)))
        return
    with pytest.raises(BitstreamDamage, match="earlier version"):
        BitstreamFile(content, job.id)
    at, count = np.frombuffer(content[-40:-24], "<u8").tolist()
    index = np.frombuffer(content[at:], np.dtype([("at", "<u8"), ("size", "<u8"), ("crc", "<u4")]), count)
    yield from (content[entry["at"] : entry["at"] + entry["size"]] for entry in index)


def test_bitstreams_of_a_kept_run_decode_to_the_same_pixels(kept: Path) -> None:
    store = Store(kept / "run")
    expected = json.loads((kept / "pixels.json").read_text())
    found = {}
    for job in store.read_plan().jobs:
        codec = installed().create("codec", job.codec.name, job.codec.params)
        found[job.codec.title] = [pixels_sha256(codec.decode(bitstream)) for bitstream in coded(store, job)]
    assert found.keys() == expected.keys()
    for title, hashes in found.items():
        assert len(hashes) == 2
        assert hashes == expected[title], title


CORPUS = read_manifest(KEPT / "bitstreams")
CONTEXT_CORPUS = read_manifest(KEPT / "bitstreams-context")
CORPUS_16 = read_manifest(KEPT / "bitstreams-16")
FILES = [("bitstreams", entry) for entry in CORPUS] + [("bitstreams-context", entry) for entry in CONTEXT_CORPUS]
FILES += [("bitstreams-16", entry) for entry in CORPUS_16]


STREAMS = sorted((KEPT / "streams").glob("*.json"))


def test_bitstreams_of_every_codec_that_ships_are_kept() -> None:
    """Of features elsewhere: `test_packets_are_the_same_on_every_machine`."""
    kept = {entry.codec for entry in (*CORPUS, *CORPUS_16)} | {path.stem for path in STREAMS} | {"orb_features"}
    assert kept == {plugin.spec.name for plugin in installed().plugins("codec")}


@pytest.mark.parametrize(("folder", "entry"), FILES, ids=[f"{folder}/{entry.file}" for folder, entry in FILES])
def test_a_kept_bitstream_decodes_to_the_same_pixels(folder: str, entry: Entry) -> None:
    """Pixels of a lossy format may differ where another version of a library decodes it."""
    bitstream = (KEPT / folder / entry.file).read_bytes()
    assert hashlib.sha256(bitstream).hexdigest() == entry.bitstream_sha256
    try:
        decoder = installed().load("codec", entry.codec).create(**entry.params)
    except Unsupported as reason:
        pytest.skip(str(reason))
    pixels = decoder.decode(bitstream)
    assert (pixels.shape[:2], 8 * pixels.itemsize) == (entry.shape[:2], entry.bits)
    if entry.codec in OWN or decoder.libraries() == entry.libraries:
        assert pixels_sha256(pixels) == entry.pixels_sha256


@pytest.mark.parametrize("path", STREAMS, ids=lambda path: path.stem)
def test_kept_packets_decode_to_the_same_pixels(path: Path) -> None:
    """In every version of a library: these standards, but for Motion JPEG, say each bit of what is decoded."""
    kept = json.loads(path.read_text())
    try:
        codec = installed().load("codec", path.stem).create()
    except Unsupported as reason:
        pytest.skip(str(reason))
    data = [base64.b85decode(text) for text in kept["packets"]]
    pictures = decoded_of(codec, [Packet(*packet) for packet in zip(data, kept["frames"], kept["starts"], strict=True)])
    assert [(picture.frame, picture.state) for picture in pictures] == [(frame, "whole") for frame in range(3)]
    if path.stem != "mjpeg" or codec.libraries() == kept["libraries"]:
        assert [pixels_sha256(picture.image) for picture in pictures] == kept["pixels_sha256"]
