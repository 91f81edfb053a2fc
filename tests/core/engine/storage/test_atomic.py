"""Files and folders appear whole or not at all, with the errors of the place that they were meant for."""

from __future__ import annotations

import errno
import os
import stat
from contextlib import nullcontext
from pathlib import Path

import pytest

from codecbench.core.engine.storage import atomic
from codecbench.core.engine.storage.atomic import (
    make_folder,
    open_whole,
    remove_folder,
    sweep,
    sync_file_system,
    write_file,
    write_folder,
)


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.fixture
def synced(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What was waited for, by the name that it has when the disk has it; of a file, its content is there by then."""
    names: list[str] = []
    wait = os.fsync

    def fsync(handle: int) -> None:
        names.append(os.readlink(f"/proc/self/fd/{handle}"))
        assert stat.S_ISDIR(os.fstat(handle).st_mode) or os.fstat(handle).st_size == 1, "it is still in a buffer"
        wait(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    return names


@pytest.mark.parametrize("durable", [False, True])
def test_a_file_is_replaced_and_may_be_read_by_all(durable: bool, tmp_path: Path) -> None:
    path = tmp_path / "far" / "away" / "file"
    for content in (b"first", b""):
        write_file(path, content, durable=durable)
        assert path.read_bytes() == content
        assert mode(path) == 0o644
    assert [entry.name for entry in path.parent.iterdir()] == ["file"]


def test_what_is_durable_is_waited_for_from_the_file_up_to_the_folder_that_was_there(
    tmp_path: Path, synced: list[str]
) -> None:
    write_file(tmp_path / "quick" / "file", b"x")
    write_folder(tmp_path / "quick" / "folder", {"a": b"x"})
    make_folder(tmp_path / "quick" / "empty")
    with open_whole(tmp_path / "quick" / "whole") as stream:
        stream.write(b"x")
    assert synced == []
    write_file(tmp_path / "far" / "away" / "file", b"x", durable=True)
    made, new, home = synced[:2], synced[2], synced[3]
    assert made == [str(tmp_path / "far"), str(tmp_path)]
    assert Path(new).name.startswith(".new-")
    assert Path(new).parent == tmp_path / "far" / "away" == Path(home)
    synced.clear()
    write_folder(tmp_path / "folder", {"a": b"x", "b": b"y"}, durable=True)
    first, second, new, home = synced
    assert (Path(first).name, Path(second).name, home) == ("a", "b", str(tmp_path))
    assert Path(first).parent == Path(second).parent == Path(new)
    assert Path(new).name.startswith(".new-")
    assert Path(new).parent == tmp_path, "a folder is not renamed from one file system into another"
    synced.clear()
    write_folder(tmp_path / "deep" / "folder", {}, durable=True)
    assert [synced[0], synced[2]] == [str(tmp_path), str(tmp_path / "deep")]
    assert len(synced) == 3


def test_a_block_that_fails_leaves_what_was_there_and_nothing_beside_it(tmp_path: Path) -> None:
    write_file(tmp_path / "file", b"old")

    def stop_halfway() -> None:
        with open_whole(tmp_path / "file") as stream:
            stream.write(b"half")
            stream.flush()
            assert (tmp_path / "file").read_bytes() == b"old"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_halfway()
    assert [(entry.name, entry.read_bytes()) for entry in tmp_path.iterdir()] == [("file", b"old")]


def test_a_pipe_is_written_to_as_it_is(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    write_file(tmp_path / "pipe", b"through")
    assert os.read(reader, 100) == b"through"
    os.close(reader)
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_an_error_names_the_place_and_not_what_is_there_meanwhile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file"

    def full(descriptor: int, *_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    for name in ("chmod", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os, name, full)
            with pytest.raises(OSError, match="No space left") as caught:
                write_file(path, b"content")
        assert (caught.value.filename, caught.value.filename2) == (str(path), None)
        assert list(tmp_path.iterdir()) == []
    (tmp_path / "in the way").write_bytes(b"")
    with pytest.raises(OSError) as blocked:
        write_file(tmp_path / "in the way" / "file", b"content")
    assert blocked.value.filename == str(tmp_path / "in the way")


def test_an_error_of_a_rename_names_the_place(tmp_path: Path) -> None:
    """A folder where the file belongs: the system names the temporary file and the place, we name the place."""

    def write_where_a_folder_is() -> None:
        with open_whole(tmp_path / "file"):
            (tmp_path / "file").mkdir()

    with pytest.raises(OSError) as caught:
        write_where_a_folder_is()
    assert (caught.value.filename, caught.value.filename2) == (str(tmp_path / "file"), None)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_a_folder_is_replaced_whole(tmp_path: Path) -> None:
    path = tmp_path / "far" / "folder"
    write_folder(path, {"old": b"1", "same": b"2"})
    write_folder(path, {"new": b"3", "same": b"4"})
    assert {entry.name: entry.read_bytes() for entry in path.iterdir()} == {"new": b"3", "same": b"4"}
    assert [entry.name for entry in path.parent.iterdir()] == ["folder"]
    assert mode(path) == 0o755


def test_a_folder_that_cannot_be_written_leaves_what_was_there(tmp_path: Path) -> None:
    write_folder(tmp_path / "folder", {"old": b"1"})
    with pytest.raises(FileNotFoundError):
        write_folder(tmp_path / "folder", {"new": b"2", "no/such": b"3"})
    assert [entry.name for entry in tmp_path.iterdir()] == ["folder"]
    assert [entry.name for entry in (tmp_path / "folder").iterdir()] == ["old"]


def test_a_folder_goes_in_one_step_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_folder(tmp_path / "folder", {"a": b"1", "b": b"2"})
    seen: list[bool] = []
    monkeypatch.setattr(atomic.shutil, "rmtree", lambda *_, **__: seen.append((tmp_path / "folder").exists()))
    remove_folder(tmp_path / "folder")
    assert seen == [False]
    (rest,) = tmp_path.iterdir()
    assert rest.name.startswith(".old-")
    monkeypatch.undo()
    sweep(tmp_path)
    write_folder(tmp_path / "folder", {"a": b"1"})
    remove_folder(tmp_path / "folder")
    assert list(tmp_path.iterdir()) == []


def test_only_rests_of_writers_are_swept(tmp_path: Path) -> None:
    for name in (".new-folder", ".old-folder", "folder", ".other"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_bytes(b"x")
    for name in (".new-file", ".old-file", "file.new-", ".newer"):
        (tmp_path / name).write_bytes(b"x")
    sweep(tmp_path)
    assert {entry.name for entry in tmp_path.iterdir()} == {"folder", ".other", "file.new-", ".newer"}
    sweep(tmp_path / "none")


def test_folders_are_made_where_they_are_missing(tmp_path: Path) -> None:
    for durable in (False, True):
        make_folder(tmp_path / "a" / "b", durable=durable)
        assert (tmp_path / "a" / "b").is_dir()
    with pytest.raises(FileNotFoundError):
        sync_file_system(tmp_path / "none")


def test_handles_are_given_back(tmp_path: Path) -> None:
    before = len(os.listdir("/proc/self/fd"))
    write_file(tmp_path / "file", b"x", durable=True)
    write_folder(tmp_path / "folder", {"a": b"x"}, durable=True)
    sync_file_system(tmp_path)
    assert len(os.listdir("/proc/self/fd")) == before


def test_a_sync_that_fails_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic, "_folder_descriptor", lambda folder: nullcontext(-1))
    with pytest.raises(OSError, match="Bad file descriptor") as caught:
        sync_file_system(tmp_path)
    assert (caught.value.errno, caught.value.filename) == (errno.EBADF, str(tmp_path))
