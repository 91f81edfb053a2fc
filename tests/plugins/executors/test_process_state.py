"""Whatever a task changes of its process is put back, or the process says that it cannot be."""

from __future__ import annotations

import ctypes
import locale
import os
import resource
import signal
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from codecbench.plugins.executors.process_state import ProcessState

UPWARDS, TO_NEAREST = 0x800, 0  # of the x86 <fenv.h>


@pytest.fixture(autouse=True)
def restored() -> Iterator[None]:
    """Puts the state before the test back after it, however it went."""
    state = ProcessState.now()
    yield
    ctypes.CDLL(None).fesetround(TO_NEAREST)
    assert state.restore()


CHANGES: dict[str, Callable[[], object]] = {
    "limits": lambda: resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1])),
    "handlers": lambda: signal.signal(signal.SIGUSR1, lambda *_: None),
    "environment": lambda: os.environ.update(OMP_NUM_THREADS="64", STRANGE="yes"),
    "folder": lambda: os.chdir("/"),
    "umask": lambda: os.umask(0o123),
    "filters": lambda: warnings.simplefilter("ignore"),
}


@pytest.mark.parametrize("part", CHANGES)
def test_a_change_is_seen_and_put_back(part: str) -> None:
    state = ProcessState.now()
    CHANGES[part]()
    changed = ProcessState.now()
    differing = {name for name in state.__dataclass_fields__ if getattr(changed, name) != getattr(state, name)}
    assert differing == {part} or (part, differing) == ("limits", set())  # the limit may have been 0 before
    assert state.restore()
    assert ProcessState.now() == state


def test_what_was_taken_out_of_the_environment_is_back() -> None:
    state = ProcessState.now()
    path = os.environ["PATH"]
    os.environ.clear()
    assert state.restore()
    assert os.environ["PATH"] == path


def test_a_folder_that_was_removed_is_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "scratch"
    folder.mkdir()
    os.chdir(folder)
    inside = ProcessState.now()
    folder.rmdir()
    assert inside.restore()
    assert Path.cwd() == folder


def test_a_locale_that_was_changed_is_put_back() -> None:
    state = ProcessState.now()
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_ALL, "C" if before != "C" else "C.UTF-8")
    assert state.restore()
    assert locale.setlocale(locale.LC_ALL) == before


@pytest.mark.skipif(os.uname().machine != "x86_64", reason="the number of a rounding mode is the processor's")
def test_a_process_that_rounds_otherwise_cannot_be_put_back() -> None:
    state = ProcessState.now()
    ctypes.CDLL(None).fesetround(UPWARDS)
    assert not state.restore()


def test_a_limit_that_was_lowered_for_good_cannot_be_put_back() -> None:
    state = ProcessState.now()
    if os.fork() == 0:
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        if os.geteuid() == 0:  # whom no limit binds
            os._exit(0)
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(64, soft), min(64, hard)))
        os._exit(0 if not state.restore() else 1)
    assert os.waitstatus_to_exitcode(os.wait()[1]) == 0
