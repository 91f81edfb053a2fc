"""The folder of a pool's workers: held while the pool lives, swept when nobody holds it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from codecbench.plugins.executors.isolation import WorkerFolder


def test_workers_have_files_of_their_own_which_go_with_the_folder(tmp_path: Path) -> None:
    folder = WorkerFolder(str(tmp_path))
    first, second = folder.files(0), folder.files(1)
    assert len({first.identity, first.output, first.scratch, second.identity, second.output, second.scratch}) == 6
    second.scratch.mkdir()
    first.output.write_text("printed")
    folder.remove()
    assert not list(tmp_path.iterdir())


def test_a_new_folder_sweeps_those_that_nobody_holds_and_no_other(tmp_path: Path) -> None:
    held = WorkerFolder(str(tmp_path))
    (tmp_path / "codecbench-workers-of-a-killed-pool").mkdir()
    (tmp_path / "codecbench-workers-of-a-killed-pool" / "lock").touch()
    (tmp_path / "somebody-else").mkdir()
    WorkerFolder(str(tmp_path)).remove()
    assert {path.name for path in tmp_path.iterdir()} == {"somebody-else", held.files(0).identity.parent.name}


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs Linux's device that is always full")
def test_a_full_disk_is_said_by_the_folder_that_was_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("codecbench.plugins.executors.isolation.open", _full, raising=False)
    with pytest.raises(OSError, match="No space left") as failure:
        WorkerFolder(str(tmp_path))
    assert failure.value.filename == str(tmp_path)
    assert not list(tmp_path.iterdir())


def _full(path: Path, mode: str, encoding: str) -> object:
    path.symlink_to("/dev/full")
    return open(path, mode, encoding=encoding)
