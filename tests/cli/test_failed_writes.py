"""What cannot be written is a sentence, and nothing half-written stays: the command, in a process of its own.

The system refuses as it would on a full or read-only disk: by a limit on the size of files, or by calls that fail.
"""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from installed_command import Done, Place, tiny_place
from recordings import pictures

from codecbench.cli.messages import ExitStatus

pytestmark = pytest.mark.thorough

PICTURED = """
version: 1
name: pictured
sequences: [{use: ramp, params: {frames: 2}}]
codecs: [{use: jpeg, params: {quality: {grid: [20, 60]}}}]
evaluators: [quality]
run: {workers: 1}
"""
"""Whose run has figures."""

OURS = """
version: 1
name: ours
sequences: [{use: folder, params: {path: recording}}]
codecs: [{use: jpeg, params: {quality: 20}}]
evaluators: [quality]
run: {workers: 1}
"""
"""Of codecbench's own plugins: quick, because it starts no hosts."""

FAILING = """
import errno, os
real = {{name: getattr(os, name) for name in ("replace", "rename", "mkdir", "fsync")}}
def failing(name):
    def fail(path, *rest, **named):
        target = str(rest[0]) if rest and name in ("replace", "rename") else str(path)
        if name == "{call}" and "{inside}" in target:
            raise OSError(errno.{error}, os.strerror(errno.{error}), str(path))
        return real[name](path, *rest, **named)
    return fail
for name in real:
    setattr(os, name, failing(name))
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """Matrices, and their finished runs in `runs/tiny` and `runs/pictured`."""
    place = tiny_place(tmp_path_factory.mktemp("writes"))
    (place.folder / "pictured.yaml").write_text(PICTURED)
    (place.folder / "ours.yaml").write_text(OURS)
    pictures(place.folder / "recording", ["1.png", "2.png"])
    assert place.call("run", "pictured.yaml").status == ExitStatus.SUCCESS
    assert place.call("bundle", "runs/tiny", "--out", "tiny.bundle.zip").status == ExitStatus.SUCCESS
    # For the first figure of all, matplotlib lists fonts with a tool that complains where it may not keep its list.
    assert place.call("plot", "runs/pictured", "--out", "drawn").status == ExitStatus.SUCCESS
    return place


def is_refused(done: Done, *said: str) -> None:
    assert done.status == ExitStatus.NOT_POSSIBLE, done.output
    lines = [line for line in done.stderr.strip().splitlines() if not line.startswith("no image of ")]
    assert lines[0].startswith("Error: "), done.output
    assert "Traceback" not in done.output
    assert "process exited" not in done.output  # a host that cannot send its answer sends the error
    for text in said:
        assert text in done.stderr


OUTPUTS = [
    "table runs/tiny --format csv --out new/kept",
    "table runs/tiny --format parquet --out new/kept",
    "report runs/tiny --out new/kept",
    "report runs/tiny --format md --out new/kept",
    "compare runs/tiny --save new/kept",
    "verify raw --only params --json new/kept",
    "bundle runs/tiny --out new/kept",
]


@pytest.mark.parametrize("words", OUTPUTS)
@pytest.mark.parametrize("there_before", [pytest.param(False, marks=pytest.mark.slow), True])
def test_an_output_that_does_not_fit_leaves_what_was_there(place: Place, words: str, there_before: bool) -> None:
    new = place.folder / "new"
    shutil.rmtree(new, ignore_errors=True)
    new.mkdir()
    if there_before:
        (new / "kept").write_text("of before")
    is_refused(place.call(*words.split(), most_bytes=8), "new/kept: File too large; ", "ulimit -f")
    assert {path.name: path.read_text() for path in new.iterdir()} == ({"kept": "of before"} if there_before else {})


FOLDERS = [
    ("examples first --out new/first.yaml", "new/first.yaml"),
    ("init --out new/matrix.yaml", "new/matrix.yaml"),
    ("export runs/pictured --codec jpeg --setting quality=20 --out new", "new"),
    ("open tiny.bundle.zip --out new/run", "new/run"),
    ("verify raw --write-corpus new", "new/raw/000.bin"),
    ("plot runs/pictured --out new", "new/ramp-rate-psnr_gray_db.svg"),
    ("reproduce runs/pictured --out new/page.md", "new/page-figures/ramp-rate-psnr_gray_db.svg"),
]
"""Commands that write several files, and the first of them."""


@pytest.mark.parametrize(("words", "first"), FOLDERS)
def test_figures_and_corpora_that_do_not_fit_leave_no_part(place: Place, words: str, first: str) -> None:
    new = place.folder / "new"
    shutil.rmtree(new, ignore_errors=True)
    is_refused(place.call(*words.split(), most_bytes=8), f"{first}: File too large")
    assert [path for path in new.rglob("*") if path.is_file()] == []


@pytest.mark.parametrize(
    "words", [OUTPUTS[0], *(pytest.param(words, marks=pytest.mark.slow) for words in [*OUTPUTS[1:], *dict(FOLDERS)])]
)
def test_an_output_on_a_full_disk_leaves_no_part(place: Place, full_disk: Path, words: str) -> None:
    done = place.call(*words.replace(" new", f" {full_disk}/new", 1).split())
    is_refused(done, f"{full_disk}/new", "No space left on device; make room on that disk")
    assert [path.name for path in full_disk.rglob("*") if path.is_file()] == ["filler"]


def test_a_run_on_a_full_disk_goes_on_when_there_is_room(place: Place, full_disk: Path) -> None:
    is_refused(place.call("run", "ours.yaml", "--out", str(full_disk / "run")), "No space left on device")
    (full_disk / "filler").unlink()
    done = place.call("run", "ours.yaml", "--out", str(full_disk / "run"))
    assert done.status == ExitStatus.SUCCESS, done.output
    assert "cells: 1 ok" in done.stdout


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    """A small disk in memory without a free byte."""
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(disk)]
    mounted = subprocess.run(command, capture_output=True, text=True)
    if mounted.returncode != 0:
        pytest.skip(f"no disk can be mounted here, which takes root: {mounted.stderr.strip()}")
    try:
        with suppress(OSError), open(disk / "filler", "wb", buffering=0) as filler:
            while filler.write(bytes(4096)):
                continue
        yield disk
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


@pytest.mark.slow
def test_a_manifest_of_kernels_that_cannot_be_written_stays_as_it_was(place: Place, tmp_path: Path) -> None:
    package = place.site / "kernelled"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "kernels.json").write_text("of before")
    (tmp_path / "sitecustomize.py").write_text(FAILING.format(call="replace", error="ENOSPC", inside="kernels.json"))
    path = os.pathsep.join([str(tmp_path), place.environment()["PYTHONPATH"]])
    done = place.call("warm-up", "tiny.yaml", "--record", "kernelled", PYTHONPATH=path)
    is_refused(done, "kernelled/kernels.json: No space left on device; make room on that disk")
    assert {path.name: path.read_text() for path in package.glob("*.json")} == {"kernels.json": "of before"}
    assert list(package.glob(".new-*")) == []
    assert place.call("warm-up", "tiny.yaml", "--record", "kernelled").status == ExitStatus.SUCCESS
    assert (package / "kernels.json").read_text() == "[\n\n]\n"


@pytest.mark.parametrize(
    ("call", "error", "said"),
    [
        ("replace", "ENOSPC", "No space left on device; make room on that disk"),
        ("replace", "EROFS", "Read-only file system; choose a place that can be written"),
        ("replace", "EACCES", "Permission denied; choose another place"),
        ("mkdir", "EROFS", "Read-only file system; choose a place that can be written"),
        ("mkdir", "EDQUOT", "Disk quota exceeded; your quota is used up"),
    ],
)
@pytest.mark.parametrize("words", [OUTPUTS[0], pytest.param(OUTPUTS[4], marks=pytest.mark.slow)])
def test_a_refusal_of_the_system_names_the_file_and_the_next_step(
    place: Place, tmp_path: Path, words: str, call: str, error: str, said: str
) -> None:
    (tmp_path / "sitecustomize.py").write_text(FAILING.format(call=call, error=error, inside="new"))
    shutil.rmtree(place.folder / "new", ignore_errors=True)
    path = os.pathsep.join([str(tmp_path), place.environment()["PYTHONPATH"]])
    is_refused(place.call(*words.split(), PYTHONPATH=path), "new", said)
    assert not (place.folder / "new").exists() or list((place.folder / "new").iterdir()) == []


@pytest.mark.parametrize(
    ("call", "inside"),
    [
        ("mkdir", "fresh"),
        pytest.param("mkdir", "records", marks=pytest.mark.slow),
        pytest.param("replace", "matrix.yaml", marks=pytest.mark.slow),
        ("replace", "plan.json"),
        pytest.param("replace", "environment", marks=pytest.mark.slow),
        ("rename", "records"),
        ("replace", ".bits"),
    ],
)
def test_a_run_that_cannot_write_says_so_and_the_next_one_completes_it(
    place: Place, tmp_path: Path, call: str, inside: str
) -> None:
    (tmp_path / "sitecustomize.py").write_text(FAILING.format(call=call, error="ENOSPC", inside=inside))
    path = os.pathsep.join([str(tmp_path), place.environment()["PYTHONPATH"]])
    out = tmp_path / "fresh"
    is_refused(place.call("run", "ours.yaml", "--out", str(out), PYTHONPATH=path), "No space left on device", str(out))
    again = place.call("run", "ours.yaml", "--out", str(out))
    assert again.status == ExitStatus.SUCCESS, again.output
    assert "cells: 1 ok" in again.stdout
    assert list(out.rglob(".new-*")) == []


@pytest.mark.parametrize(
    "size", [0, pytest.param(40, marks=pytest.mark.slow), pytest.param(200, marks=pytest.mark.slow)]
)
def test_a_run_on_a_disk_that_is_full_at_the_start_says_so(place: Place, tmp_path: Path, size: int) -> None:
    done = place.call("run", "tiny.yaml", "--out", str(tmp_path / "run"), most_bytes=size)
    if size == 0:  # not even a temporary file of a host can be made, which comes before the run folder
        is_refused(done, "No usable temporary directory", "; make room in one of them, or set TMPDIR to a folder")
    else:
        is_refused(done, str(tmp_path / "run"), "File too large")
    assert place.call("run", "tiny.yaml", "--out", str(tmp_path / "run")).status == ExitStatus.SUCCESS


def test_no_room_for_temporary_files_is_told_before_any_worker_starts(place: Place, tmp_path: Path) -> None:
    """The plan and the log fit into files of this size; what workers may need for temporary files does not."""
    (tmp_path / "temporary").mkdir()
    arguments = ("run", "ours.yaml", "--out", str(tmp_path / "run"))
    done = place.call(*arguments, most_bytes=30_000, TMPDIR=str(tmp_path / "temporary"))
    is_refused(done, str(tmp_path / "temporary"), "File too large")
    assert "expired" not in done.output
    assert list((tmp_path / "temporary").iterdir()) == []
    assert place.call(*arguments).status == ExitStatus.SUCCESS


def test_devices_are_written_to_and_stay_devices(place: Place, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    done = place.call("table", "runs/tiny", "--format", "csv", "--out", str(tmp_path / "pipe"))
    assert done.status == ExitStatus.SUCCESS, done.output
    assert os.read(reader, 10_000).startswith(b"sequence,codec,setting")
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()
