"""The server that workers are forked from: what they inherit from their program, and that all end with it."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from codecbench.core.contracts.executor import Task
from codecbench.plugins.executors.local import LocalExecutor


def prepare() -> None:
    return None


def value(function: Callable[[object], Any], argument: object = None) -> Any:
    """What a function returns in a worker of a new executor."""
    executor = LocalExecutor()
    executor.start(1, prepare)
    try:
        executor.submit(Task("only", function, argument))
        while (finished := executor.next_finished(1.0)) is None:
            pass
        assert finished.status == "ok", finished
        return finished.value
    finally:
        executor.stop()


def variable(_: object) -> str | None:
    return os.environ.get("CODECBENCH_TEST_VARIABLE")


def umask(_: object) -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


def where_numba_came_from(_: object) -> str:
    return str(sys.modules["numba"].__file__)


def write_pid_and_hang(path: object) -> None:
    Path(str(path)).write_text(str(os.getpid()))
    ctypes.PyDLL(None).sleep(3600)  # PyDLL keeps the interpreter locked


def wait_for(path: Path) -> None:
    while not path.exists():
        time.sleep(0.02)


def stay_until_told(folder: object) -> None:
    Path(str(folder), "there").touch()
    wait_for(Path(str(folder), "told"))


def test_each_worker_has_the_variables_and_the_umask_of_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    for text, mask in (("first", 0o022), ("second", 0o077)):
        monkeypatch.setenv("CODECBENCH_TEST_VARIABLE", text)
        before = os.umask(mask)
        try:
            assert (value(variable), value(umask)) == (text, mask)
        finally:
            os.umask(before)


@pytest.mark.thorough
def test_modules_of_the_folder_where_the_program_starts_are_not_loaded(tmp_path: Path) -> None:
    (tmp_path / "numba.py").write_text("raise SystemExit('this is not numba')\n")
    program = (
        f"import sys; sys.path[:0] = [{str(Path(__file__).parent)!r}]\n"
        "from test_fork_server import value, where_numba_came_from; print(value(where_numba_came_from))\n"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=120
    )
    assert done.stdout.strip().endswith("numba/__init__.py"), done.stderr


def kill_program(folder: Path) -> list[psutil.Process]:
    """Kill a program one of whose workers is in C, its temporary files in `folder`; returns what it had started."""
    note = folder / "pid"
    program = (
        f"import sys; sys.path[:0] = [{str(Path(__file__).parent)!r}]\n"
        "from test_fork_server import LocalExecutor, Task, prepare, write_pid_and_hang\n"
        "executor = LocalExecutor(); executor.start(1, prepare)\n"
        f"executor.submit(Task('a', write_pid_and_hang, {str(note)!r}))\n"
        "while True: executor.next_finished(1.0)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], env={**os.environ, "TMPDIR": str(folder)}) as other:
        while not (note.exists() and note.read_text()):
            assert other.poll() is None
            time.sleep(0.05)
        started = psutil.Process(other.pid).children(recursive=True)
        assert int(note.read_text()) in {process.pid for process in started}
        other.kill()
    return started


@pytest.mark.thorough
def test_a_killed_program_leaves_no_process_even_where_a_worker_is_in_c(tmp_path: Path) -> None:
    gone, left = psutil.wait_procs(kill_program(tmp_path), timeout=300)
    assert not left
    assert gone


@pytest.mark.slow
@pytest.mark.parametrize("trial", range(20))
def test_the_folder_of_the_socket_goes_with_the_server_of_a_killed_program(tmp_path: Path, trial: int) -> None:
    psutil.wait_procs(kill_program(tmp_path), timeout=300)
    assert [path for folder in tmp_path.glob("pymp-*") for path in (folder, *folder.iterdir())] == []


@pytest.mark.thorough
def test_a_server_that_ends_leaves_the_socket_of_another_in_the_same_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CODECBENCH_TEST_VARIABLE", "there")
    assert value(variable) == "there"
    spawned = multiprocessing.get_context("spawn").Process(target=value, args=(stay_until_told, tmp_path))
    spawned.start()
    wait_for(tmp_path / "there")
    servers = psutil.Process(spawned.pid).children(recursive=True)
    (tmp_path / "told").touch()
    spawned.join()
    assert spawned.exitcode == 0
    assert servers
    assert not psutil.wait_procs(servers, timeout=300)[1]
    assert value(variable) == "there"


@pytest.mark.thorough
def test_workers_start_where_the_folder_for_temporary_files_has_a_long_name(tmp_path: Path) -> None:
    folder = tmp_path / ("long" * 30)
    folder.mkdir()
    program = (
        f"import sys; sys.path[:0] = [{str(Path(__file__).parent)!r}]\n"
        "from test_fork_server import value, variable; print(value(variable))\n"
    )
    environment = {**os.environ, "TMPDIR": str(folder), "CODECBENCH_TEST_VARIABLE": "there"}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.stdout.strip() == "there", done.stderr
    assert list(folder.iterdir()) == []
