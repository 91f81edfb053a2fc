"""The local executor: whatever a task does, it alone bears it."""

from __future__ import annotations

import ctypes
import mmap
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pebble import ProcessPool
from pebble.pool.process import PoolManager

from codecbench.core.contracts.executor import Finished, Task
from codecbench.core.contracts.held_folder import left_running
from codecbench.plugins.executors import pool
from codecbench.plugins.executors.local import LocalExecutor
from codecbench.plugins.executors.process_tree import is_running


def prepare() -> None:
    return None


def double(value: int) -> int:
    return 2 * value


def pid(_: object) -> int:
    return os.getpid()


def fail(text: str) -> None:
    raise ValueError(text)


def segfault(_: object) -> None:
    ctypes.string_at(0)


def leave(status: int) -> None:
    os._exit(status)


def hang_in_c(note: str) -> None:
    Path(note).touch()
    ctypes.PyDLL(None).sleep(3600)  # PyDLL keeps the interpreter locked


def hang_in_c_until_it_is_told(note: str) -> None:
    """The note says that this worker has told where it hangs."""
    told = f"until grep -q hang_in_c /proc/{os.getpid()}/fd/2; do sleep 0.02; done; touch '{note}'"
    subprocess.Popen(["sh", "-c", told])
    hang_in_c(f"{note} of the hang")


def allocate(mb: int) -> int:
    return int(np.ones(mb << 20, np.uint8)[-1])


_leaked: list[Any] = []


def leak(mb: int) -> int:
    _leaked.append(np.ones(mb << 20, np.uint8))
    return os.getpid()


def share_memory(mb: int) -> None:
    block = mmap.mmap(-1, mb << 20)
    for _ in range(mb):
        block.write(b"x" * (1 << 20))
    time.sleep(3600)


def fork_and_hang(note: str) -> None:
    children = [subprocess.Popen(["sleep", "3600"]), subprocess.Popen(["sleep", "3600"], start_new_session=True)]
    Path(f"{note}.pids").write_text(" ".join(str(child.pid) for child in children))
    Path(note).touch()
    time.sleep(3600)


def fork_and_return(_: object) -> int:
    return subprocess.Popen(["sleep", "3600"]).pid


def leave_for_the_next(_: object) -> int:
    left = subprocess.Popen(["sleep", "3600"]).pid
    left_running.add(left)
    return left


def leave_files_and_hang(note: str) -> None:
    Path(tempfile.mkdtemp(prefix="left-by-a-codec-"), "large").write_bytes(b"x")
    hang_in_c(note)


def print_noise(count: int) -> str:
    for _ in range(count):
        sys.stdout.write("noise on stdout\n")
        os.write(2, b"noise on stderr\n")
    return "quiet"


def report_affinity(_: object) -> tuple[float, float, int]:
    begun = time.monotonic()
    time.sleep(0.3)
    return begun, time.monotonic(), len(os.sched_getaffinity(0))


def threads(_: object) -> dict[str, str | None]:
    return {name: os.environ.get(name) for name in ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")}


def main_name(_: object) -> Any:
    return getattr(sys.modules["__main__"], "__file__", None)


@pytest.fixture(scope="module")
def executor() -> Iterator[LocalExecutor]:
    executor = LocalExecutor()
    executor.start(2, prepare)
    yield executor
    executor.stop()


class Clock:
    """The pool's clock, which stands still until a test moves it."""

    now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(pool, "time", clock)
    return clock


def outcomes(executor: LocalExecutor, *tasks: Task) -> dict[str, Finished]:
    for task in tasks:
        executor.submit(task)
    found: dict[str, Finished] = {}
    while len(found) < len(tasks):
        finished = executor.next_finished(1.0)
        if finished is not None:
            found[finished.task_id] = finished
    return found


def wait_for(path: Path) -> None:
    while not path.exists():
        time.sleep(0.02)


def hung(
    executor: LocalExecutor, clock: Clock, function: Callable[[str], None], note: Path, timeout_s: float = 900.0
) -> Finished:
    """What becomes of a task that hangs behind its note, when its limit is over, and of others before that."""
    executor.submit(Task("bad", function, str(note), timeout_s=timeout_s))
    others = outcomes(executor, *(Task(f"other-{n}", double, n) for n in range(3)))
    assert [others[f"other-{n}"].value for n in range(3)] == [0, 2, 4]
    wait_for(note)
    assert executor.next_finished(0.0) is None
    while (finished := executor.next_finished(0.0)) is None:
        clock.now_s += 0.5 * timeout_s
    return finished


def beside_others(executor: LocalExecutor, task: Task) -> Finished:
    """Run `task` among innocent ones, which must all come back."""
    others = [Task(f"other-{n}", double, n) for n in range(6)]
    found = outcomes(executor, *others[:3], task, *others[3:])
    assert [found[other.id].value for other in others] == [0, 2, 4, 6, 8, 10]
    return found[task.id]


def test_values_come_back_from_reused_workers(executor: LocalExecutor) -> None:
    found = outcomes(executor, *(Task(str(n), pid, None) for n in range(12)))
    assert {one.status for one in found.values()} == {"ok"}
    assert 1 <= len({one.value for one in found.values()}) <= 2


def test_an_exception_is_failed_with_its_traceback(executor: LocalExecutor) -> None:
    found = beside_others(executor, Task("bad", fail, "two\nlines"))
    assert (found.status, found.reason) == ("failed", "ValueError: two lines")
    assert "in fail" in found.traceback


def test_a_segfault_names_its_signal_and_where_it_was(executor: LocalExecutor) -> None:
    found = beside_others(executor, Task("bad", segfault, None))
    assert found.status == "crashed"
    assert "killed by SIGSEGV" in found.reason
    assert "segfault" in found.traceback


@pytest.mark.parametrize("status", [0, pytest.param(3, marks=pytest.mark.thorough)])
def test_a_worker_that_exits_crashed(executor: LocalExecutor, status: int) -> None:
    found = beside_others(executor, Task("bad", leave, status))
    assert found.status == "crashed"
    assert f"status {status}" in found.reason


def test_a_hang_in_c_is_timed_out_and_says_where(executor: LocalExecutor, clock: Clock, tmp_path: Path) -> None:
    found = hung(executor, clock, hang_in_c_until_it_is_told, tmp_path / "note", timeout_s=2.0)
    assert (found.status, found.reason) == ("timed_out", "no result within 2 s")
    assert "hang_in_c" in found.traceback


def test_an_allocation_past_the_cap_fails_and_one_below_does_not(executor: LocalExecutor) -> None:
    assert outcomes(executor, Task("good", allocate, 200, memory_mb=300))["good"].value == 1
    found = beside_others(executor, Task("bad", allocate, 400, memory_mb=300))
    assert found.status == "failed"
    assert "MemoryError" in found.reason or "allocate" in found.reason


@pytest.mark.thorough
def test_a_worker_with_leaked_memory_is_replaced_before_the_next_task() -> None:
    executor = LocalExecutor()
    executor.start(1, prepare)
    try:
        leaker = outcomes(executor, Task("leak", leak, 200, memory_mb=300))["leak"]
        assert leaker.status == "ok"
        found = outcomes(executor, Task("next", allocate, 250, memory_mb=300), Task("pid", pid, None))
        assert found["next"].value == 1
        assert found["pid"].value != leaker.value
    finally:
        executor.stop()


def test_memory_that_the_limit_does_not_see_is_watched(executor: LocalExecutor) -> None:
    found = beside_others(executor, Task("bad", share_memory, 400, memory_mb=300))
    assert found.status == "crashed"
    assert "memory_mb allows 300" in found.reason


def test_children_die_with_a_timed_out_worker(executor: LocalExecutor, clock: Clock, tmp_path: Path) -> None:
    assert hung(executor, clock, fork_and_hang, tmp_path / "note").status == "timed_out"
    _expect_gone(*map(int, (tmp_path / "note.pids").read_text().split()))


def test_children_left_behind_are_ended(executor: LocalExecutor) -> None:
    found = beside_others(executor, Task("fork", fork_and_return, None))
    assert found.status == "ok"
    _expect_gone(found.value)


def test_a_process_that_a_task_leaves_for_the_next_one_is_not_ended(executor: LocalExecutor) -> None:
    left = outcomes(executor, Task("leave", leave_for_the_next, None))["leave"].value
    found = outcomes(executor, *(Task(str(n), fork_and_return, None) for n in range(4)))
    _expect_gone(*(one.value for one in found.values()))
    assert is_running(left)
    os.kill(left, signal.SIGKILL)


def _expect_gone(*pids: int) -> None:
    while any(map(is_running, pids)):
        time.sleep(0.02)


def test_noise_stays_in_the_worker(executor: LocalExecutor, capfd: pytest.CaptureFixture[str]) -> None:
    found = beside_others(executor, Task("noisy", print_noise, 1000))
    assert found.value == "quiet"
    assert capfd.readouterr() == ("", "")


def test_a_result_that_does_not_pickle_costs_its_task_alone(executor: LocalExecutor) -> None:
    found = beside_others(executor, Task("bad", eval, "lambda: 0"))
    assert found.status in ("failed", "crashed")
    assert found.reason


@pytest.mark.thorough
def test_exclusive_tasks_run_alone_on_one_core(executor: LocalExecutor) -> None:
    tasks = [Task(str(n), report_affinity, None, exclusive=n in (2, 3)) for n in range(5)]
    found = outcomes(executor, *tasks)
    spans = [found[task.id].value for task in tasks]
    for n in (2, 3):
        assert spans[n][2] == 1
        others = [span for other, span in enumerate(spans) if other != n]
        assert all(end <= spans[n][0] or begin >= spans[n][1] for begin, end, _ in others)


def test_workers_are_single_threaded_and_do_not_run_the_main_script(executor: LocalExecutor) -> None:
    found = outcomes(executor, Task("threads", threads, None), Task("main", main_name, None))
    assert set(found["threads"].value.values()) == {"1"}
    assert found["main"].value is None


def test_a_killed_worker_is_a_crash_and_an_idle_one_is_replaced(executor: LocalExecutor) -> None:
    for one in {found.value for found in outcomes(executor, *(Task(str(n), pid, None) for n in range(8))).values()}:
        os.kill(one, signal.SIGKILL)
    assert outcomes(executor, Task("after", double, 4))["after"].value == 8


def test_stop_ends_a_hanging_worker_at_once(tmp_path: Path) -> None:
    executor = LocalExecutor()
    executor.start(1, prepare)
    worker = outcomes(executor, Task("pid", pid, None))["pid"].value
    executor.submit(Task("hang", hang_in_c, str(tmp_path / "note")))
    wait_for(tmp_path / "note")
    executor.stop()
    executor.stop()
    _expect_gone(worker)


def rests(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.name.startswith(("codecbench-", "left-by"))]


def test_temporary_files_go_with_the_process_that_left_them(
    clock: Clock, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    executor = LocalExecutor()
    executor.start(2, prepare)
    assert hung(executor, clock, leave_files_and_hang, tmp_path / "note").status == "timed_out"
    assert [path.name.rsplit("-", 1)[0] for path in rests(tmp_path)] == ["codecbench-workers"]
    executor.stop()
    assert not rests(tmp_path)


@pytest.mark.thorough
def test_what_a_killed_coordinator_left_is_swept_and_what_is_in_use_is_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    program = (
        "import time; from codecbench.plugins.executors.pool import WorkerPool; "
        "pool = WorkerPool(1, print); print('there', flush=True); time.sleep(3600)"
    )
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, env=environment) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == b"there\n"
        (theirs,) = rests(tmp_path)
        first = LocalExecutor()
        first.start(1, prepare)
        assert theirs.exists()
        other.kill()
    second = LocalExecutor()
    second.start(1, prepare)
    assert not theirs.exists()
    assert outcomes(first, Task("a", double, 2))["a"].value == 4
    first.stop()
    second.stop()
    assert not rests(tmp_path)


def working_folder(_: object) -> str:
    return os.getcwd()


def test_workers_are_in_a_folder_of_their_own(executor) -> None:  # type: ignore[no-untyped-def]
    folder = outcomes(executor, Task("folder", working_folder, None))["folder"].value
    assert folder != os.getcwd()
    assert "codecbench-workers-" in folder


@pytest.mark.thorough
def test_a_worker_that_ends_unseen_before_it_begins_a_task_is_replaced(
    executor: LocalExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a busy machine, where pebble looks after its workers late."""
    monkeypatch.setattr(PoolManager, "update_workers", lambda _: None)
    tasks = [Task(name, leak, mb, memory_mb=300, exclusive=True) for name, mb in {"crowd": 200, "next": 1}.items()]
    done = outcomes(executor, *tasks)
    assert done["next"].status == "ok", done["next"].reason
    assert done["next"].value != done["crowd"].value


@pytest.mark.thorough
def test_a_worker_that_cannot_be_started_is_started_again(
    executor: LocalExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where the server that forks workers dies of a signal to the whole group of processes."""
    schedule, failures = ProcessPool.schedule, {"late": 2, "never": 10}

    def broken(pool: ProcessPool, function: Any, args: tuple[Task]) -> Any:
        if failures.get(args[0].id, 0):
            failures[args[0].id] -= 1
            raise BrokenProcessPool
        return schedule(pool, function, args=args)

    monkeypatch.setattr(ProcessPool, "schedule", broken)
    assert beside_others(executor, Task("late", double, 4)).value == 8
    lost = beside_others(executor, Task("never", double, 4))
    assert (lost.status, failures) == ("crashed", {"late": 0, "never": 7})
    assert "could not start" in lost.reason


def say_and_die(path: str) -> None:
    """Leave a trace, and take along the server that forked this process."""
    with open(path, "a") as file:
        file.write("begun\n")
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(3600)


def say_and_sleep(path: str) -> None:
    Path(path).touch()
    time.sleep(3600)


def wait_and_die(path: str) -> None:
    wait_for(Path(path))
    say_and_die(path)


@pytest.mark.thorough
def test_a_worker_that_is_lost_with_its_server_is_not_blamed(executor: LocalExecutor, tmp_path: Path) -> None:
    for name, function in {"innocent": say_and_sleep, "culprit": wait_and_die}.items():
        executor.submit(Task(name, function, str(tmp_path / "trace")))
    ends: list[Finished] = []
    while len(ends) < 2:
        ends += filter(None, [executor.next_finished(1.0)])
    assert {(end.task_id, end.status) for end in ends} == {("innocent", "crashed"), ("culprit", "crashed")}
    assert all("worker was lost" in end.reason for end in ends)
    assert beside_others(executor, Task("next", double, 4)).value == 8


@pytest.mark.thorough
def test_a_task_that_has_begun_is_not_begun_again(
    executor: LocalExecutor, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Also where the pool never hears of its worker that it took the task."""
    monkeypatch.setattr(PoolManager, "process_next_message", lambda *_: time.sleep(0.05))
    executor.submit(Task("once", say_and_die, str(tmp_path / "trace")))
    while (found := executor.next_finished(1.0)) is None:
        pass
    assert found.status == "crashed"
    assert (tmp_path / "trace").read_text() == "begun\n"
