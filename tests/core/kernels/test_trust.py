"""Compiled kernels are code: what others own or may write is refused, and kernels are compiled all the same."""

from __future__ import annotations

import hashlib
import logging
import os
import pickle
from collections.abc import Iterator
from pathlib import Path

import numba
import pytest

from codecbench.core.kernels import folders
from codecbench.core.kernels.compiled import compiled
from codecbench.core.kernels.folders import kernel_folder, objection, precompiled_folders, read_trusted


@compiled
def tripled(value):
    return 3 * value


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The kernels' folder in a cache of its own, and another for when it is refused."""
    monkeypatch.setenv("CODECBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(folders, "_reported", set())
    made = tmp_path / "cache" / "kernels"
    made.mkdir(mode=0o755, parents=True)
    return made


def facts(user: int, mode: int) -> os.stat_result:
    return os.stat_result((mode, 1, 1, 1, user, 50, 10, 0, 0, 0))


@pytest.mark.parametrize("mode", [0o100644, 0o100600, 0o100444, 0o40755, 0o40700, 0o40555])
def test_what_this_user_or_root_alone_may_write_is_trusted(mode: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folders, "current_user", lambda: 1000)
    assert objection(facts(1000, mode)) is None
    assert objection(facts(0, mode)) is None
    assert "user 54321" in str(objection(facts(54321, mode)))


@pytest.mark.parametrize(
    ("mode", "spelt"), [(0o100664, "-rw-rw-r--"), (0o100602, "-rw-----w-"), (0o41777, "drwxrwxrwt")]
)
def test_what_others_may_write_is_not(mode: int, spelt: str) -> None:
    assert f"({spelt})" in str(objection(facts(0, mode)))


def test_root_does_not_run_what_a_user_wrote(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folders, "current_user", lambda: 0)
    assert "user 54321" in str(objection(facts(54321, 0o100644)))


def test_a_folder_that_others_may_write_is_left_for_the_users_own(
    folder: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    assert kernel_folder() == folder
    folder.chmod(0o777)
    with caplog.at_level(logging.WARNING):
        assert kernel_folder() == tmp_path / "home" / "codecbench" / "kernels"
        kernel_folder()
    (said,) = caplog.messages
    assert said.startswith(f"{folder}: ")
    assert "(drwxrwxrwx)" in said
    assert "chmod -R go-w" in said


def test_where_no_folder_is_trusted_kernels_are_compiled_in_memory(folder: Path, tmp_path: Path) -> None:
    folder.chmod(0o777)
    own = tmp_path / "home" / "codecbench" / "kernels"
    own.mkdir(parents=True)
    own.chmod(0o775)
    assert kernel_folder() is None
    assert tripled(14) == 42
    assert [*folder.iterdir(), *own.iterdir()] == []


def test_a_given_folder_is_read_after_the_cache_and_checked_like_it(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = (numba.int16,)
    tripled.compile(arguments)
    kept = tripled._cache.file(arguments, tripled.targetctx.codegen())
    given = tmp_path / "given"
    given.mkdir(mode=0o755)
    monkeypatch.setenv("CODECBENCH_KERNELS", str(given))
    moved = kept.rename(given / kept.name)
    assert tripled._cache.load_overload(arguments, tripled.targetctx) is not None
    content = moved.read_bytes()
    moved.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    assert tripled._cache.load_overload(arguments, tripled.targetctx) is None, "a flipped bit"
    moved.write_bytes(content)
    given.chmod(0o777)
    assert precompiled_folders() == []
    assert tripled._cache.load_overload(arguments, tripled.targetctx) is None


class Escape:
    """Pickled code that says where it was run."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> object:
        return Path.touch, (self.path,)


@pytest.mark.parametrize("spoilt", ["mode", "owner"])
def test_a_planted_kernel_is_not_run_but_compiled_again(
    spoilt: str, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = (numba.float32,) if spoilt == "mode" else (numba.int32,)
    file = tripled._cache.file(arguments, tripled.targetctx.codegen())
    assert file.parent == folder
    payload = pickle.dumps(Escape(tmp_path / "ran"))
    content = hashlib.sha256(payload).digest() + payload
    file.write_bytes(content)
    file.chmod(0o646 if spoilt == "mode" else 0o644)
    if spoilt == "owner":
        os.utime(file, (1, 1))
        told = folders.objection
        of_another = "it belongs to user 54321"
        monkeypatch.setattr(folders, "objection", lambda facts: of_another if facts.st_mtime == 1 else told(facts))
    assert read_trusted(file) is None
    assert tripled._cache.load_overload(arguments, tripled.targetctx) is None
    tripled.compile(arguments)
    assert not (tmp_path / "ran").exists()
    made = read_trusted(file)
    assert made is not None
    assert made != content


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file away; the test above fakes its owner")
def test_a_file_and_a_folder_given_away(folder: Path, tmp_path: Path) -> None:
    (folder / "file").write_bytes(b"code")
    assert read_trusted(folder / "file") == b"code"
    os.chown(folder / "file", 54321, 54321)
    assert read_trusted(folder / "file") is None
    os.chown(folder, 54321, 54321)
    assert kernel_folder() == tmp_path / "home" / "codecbench" / "kernels"
