"""The lock of a run folder: one process at a time, who it is, and gone with it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.storage import folder_lock

HOLDER = """
import sys
from pathlib import Path
from codecbench.core.engine.storage import folder_lock
with folder_lock.hold_lock(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_one_process_holds_it_until_it_ends_however_that_ends(tmp_path: Path) -> None:
    lock = tmp_path / "lock"
    assert not folder_lock.is_locked(lock)
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(lock)], stdin=pipe, stdout=pipe) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"held\n"
        assert folder_lock.is_locked(lock)
        with pytest.raises(StoreError, match=f"process {other.pid} on .*--out"), folder_lock.hold_lock(lock):
            pass
        other.kill()
    assert not folder_lock.is_locked(lock)
    with folder_lock.hold_lock(lock):
        assert folder_lock.is_locked(lock)
        assert lock.read_text().startswith(f"process {os.getpid()} on ")
    assert not folder_lock.is_locked(lock)


def test_a_link_is_never_said_to_be_held(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").touch()
    (tmp_path / "lock").symlink_to(tmp_path / "elsewhere")
    with folder_lock.hold_lock(tmp_path / "elsewhere"):
        assert not folder_lock.is_locked(tmp_path / "lock")
