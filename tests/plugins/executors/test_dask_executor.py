"""The dask executor: the same results as the local one, through dying workers and without shared files."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from dask_cluster import cluster_elsewhere
from engine_bench import OURS, Bench, bench_in, contents, grid, matrix, write_stack
from project import SUPPORT
from pydantic import ValidationError

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.executor import Finished, Task
from codecbench.core.engine.planning.model import Cell
from codecbench.core.engine.running.progress import Progress
from codecbench.plugins.executors.dask import DaskExecutor, DaskParams

dask = pytest.importorskip("dask")
pytest.importorskip("distributed", reason="the extra codecbench[dask] is not installed")

pytestmark = pytest.mark.thorough

CODECS = "{use: faulty, params: {step: {grid: [0, 1, 2]}}}"


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path) as made:
        yield made


def on_dask(params: str = "", more: str = "") -> str:
    return f"workers: 2, executor: {{use: dask, params: {{{params}}}}}{more}"


def test_local_and_dask_runs_find_the_same(bench: Bench) -> None:
    hangs = {}
    for name, run in (("local", "workers: 2, timeout_s: 6"), ("dask", on_dask(more=", timeout_s: 6"))):
        hanging = bench.plan(matrix(grid("faulty", ["hang"]), "wandering, whole", run))
        assert bench.run(hanging, f"hanging {name}").statuses == {"timed_out": 2}
        hangs[name] = contents(bench.store(f"hanging {name}"), hanging)
    assert hangs["dask"] == hangs["local"]
    codecs = f"{OURS}, {grid('faulty', ['raise', 'segfault'])}"
    evaluators = "wandering, whole, alone"
    local = bench.plan(matrix(codecs, evaluators))
    bench.run(local, "local")
    plan = bench.plan(matrix(codecs, evaluators, on_dask()))
    order: list[Cell] = []
    summary = bench.run(plan, "dask", listener=lambda one: order.append(one.cell) if one.cell else None)
    assert [cell.id for cell in plan.cells] == [cell.id for cell in local.cells]
    assert contents(bench.store("dask"), plan) == contents(bench.store("local"), local)
    assert summary.statuses == {"ok": 12, "failed": 2, "crashed": 2}
    alone = [bench.store("dask").read_record(cell.id) for cell in plan.cells if cell.exclusive]
    good = [record for record in alone if record.status == "ok"]
    assert len({record.worker["pid"] for record in good}) == 1, "exclusive cells go to one worker"
    assert {one.value for record in good for one in record.measurements if one.metric == "cores"} == {1.0}


def prepare() -> None:
    return None


def dask_worker() -> int:
    """The dask worker that wanted this process; its parent is the server that forked it."""
    wanting = multiprocessing.parent_process()
    assert wanting is not None
    assert wanting.pid is not None
    return wanting.pid


def slow_pid(seconds: float) -> int:
    time.sleep(seconds)
    return dask_worker()


def slow_size(content: bytes) -> tuple[int, int]:
    time.sleep(1.5)
    return len(content), dask_worker()


def kill_worker(_: object) -> None:
    os.kill(dask_worker(), signal.SIGKILL)
    time.sleep(60)


@contextmanager
def started(params: DaskParams) -> Iterator[DaskExecutor]:
    executor = DaskExecutor(params)
    try:
        executor.start(2, prepare)
        yield executor
    finally:
        executor.stop()


def outcomes(executor: DaskExecutor, *tasks: Task, within_s: float = 120.0) -> dict[str, Finished]:
    for task in tasks:
        executor.submit(task)
    return awaited(executor, len(tasks), within_s)


def awaited(executor: DaskExecutor, count: int, within_s: float = 120.0) -> dict[str, Finished]:
    found: dict[str, Finished] = {}
    deadline = time.monotonic() + within_s
    while len(found) < count:
        assert time.monotonic() < deadline, f"only {sorted(found)} ended"
        finished = executor.next_finished(1.0)
        if finished is not None:
            found[finished.task_id] = finished
    return found


def test_a_worker_that_dies_has_its_tasks_tried_again_and_a_deadly_task_given_up() -> None:
    with started(DaskParams(retries=2)) as executor:
        victim = outcomes(executor, Task("first", slow_pid, 0.0))["first"].value
        threading.Timer(1.0, os.kill, (victim, signal.SIGKILL)).start()
        found = outcomes(executor, *(Task(f"slow-{n}", slow_pid, 2.0) for n in range(2)))
        assert {one.status for one in found.values()} == {"ok"}
        assert victim not in {one.value for one in found.values()}
        deadly = outcomes(executor, Task("deadly", kill_worker, None))["deadly"]
        assert deadly.status == "crashed"
        assert "(KilledWorker" in deadly.reason
        assert outcomes(executor, Task("after", slow_pid, 0.0))["after"].status == "ok"


@pytest.mark.slow
def test_workers_that_are_all_lost_are_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also those that are killed while they start, which dask's nannies do not start again."""
    monkeypatch.setattr("codecbench.plugins.executors.dask._LOOK_EVERY_S", 1.0)
    earlier = psutil.Process().children(recursive=True)
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "1s"}), started(DaskParams()) as executor:
        before = {one.value for one in outcomes(executor, Task("a", slow_pid, 0.5), Task("b", slow_pid, 0.5)).values()}
        until = time.monotonic() + 4
        while time.monotonic() < until:
            for one in spawned(earlier):
                if one.ppid() == os.getpid():
                    one.kill()
            time.sleep(0.05)
        after = {one.value for one in outcomes(executor, Task("c", slow_pid, 0.5), Task("d", slow_pid, 0.5)).values()}
    assert not before & after


def test_a_cluster_without_workers_is_told_in_time(bench: Bench) -> None:
    with cluster_elsewhere(bench.folder / "cluster", bench.site, workers=1) as cluster:
        params = DaskParams(address=cluster.address, start_timeout_s=8.0)
        with started(params) as executor:
            assert outcomes(executor, Task("a", slow_pid, 0.0))["a"].status == "ok"
            os.kill(cluster.workers[0], signal.SIGKILL)
            with pytest.raises(CodecbenchError, match=f"worker at {re.escape(cluster.address)} for 8 s"):
                outcomes(executor, Task("b", slow_pid, 0.0))


@pytest.mark.slow
def test_a_large_task_survives_the_worker_that_held_it() -> None:
    with started(DaskParams()) as executor:
        first = outcomes(executor, Task("a", slow_pid, 0.5), Task("b", slow_pid, 0.5))
        victim = first["a"].value
        threading.Timer(1.0, os.kill, (victim, signal.SIGKILL)).start()
        found = outcomes(executor, *(Task(f"large-{n}", slow_size, os.urandom(3 << 20)) for n in range(4)))
    assert {(one.status, one.value[0]) for one in found.values()} == {("ok", 3 << 20)}


def hang_in_c(path: str) -> None:
    """Say who this is and wait in C without letting Python run, so that nothing but the system can end it."""
    Path(path).write_text(str(os.getpid()))
    ctypes.PyDLL(None).sleep(300)


def hanging(executor: DaskExecutor, path: Path) -> psutil.Process:
    """The isolated process of a task that hangs, once it does."""
    executor.submit(Task("hang", hang_in_c, str(path)))
    deadline = time.monotonic() + 60
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < deadline, "the task did not begin"
        time.sleep(0.05)
    return psutil.Process(int(path.read_text()))


def spawned(earlier: list[psutil.Process]) -> list[psutil.Process]:
    """The processes below this one that are not among the earlier ones, without Python's own resource tracker."""
    kinds = re.compile("spawn_main|multiprocessing.forkserver|^dask worker")
    new = [one for one in psutil.Process().children(recursive=True) if one not in earlier]
    return [one for one in new if kinds.search(" ".join(_command(one)))]


def gone(*processes: psutil.Process) -> bool:
    return not psutil.wait_procs(processes, timeout=20)[1]


def test_stop_ends_hanging_tasks_and_leaves_no_process(tmp_path: Path) -> None:
    earlier = psutil.Process().children(recursive=True)
    with started(DaskParams()) as executor:
        victim = hanging(executor, tmp_path / "pid")
        children = spawned(earlier)
        assert victim in children
        begun = time.monotonic()
    assert time.monotonic() - begun < 30
    assert gone(*children)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_isolated_processes_end_with_their_dask_worker(tmp_path: Path, number: signal.Signals) -> None:
    with started(DaskParams(retries=0)) as executor:
        victim = hanging(executor, tmp_path / "pid")
        os.kill(victim.ppid(), number)
        assert gone(victim)
        assert awaited(executor, 1)["hang"].status == "crashed"


def _command(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def test_workers_that_share_no_files_with_the_coordinator(bench: Bench) -> None:
    local = bench.plan(matrix(OURS, "quality, whole"))
    bench.run(local, "local")
    for name in ("here", "there"):
        (bench.folder / name).mkdir()
    shutil.copy(bench.folder / "stack.npy", bench.folder / "there" / "stack.npy")
    shutil.move(bench.folder / "stack.npy", bench.folder / "here" / "stack.npy")
    with cluster_elsewhere(bench.folder / "cluster", bench.site) as cluster:
        paths = f"{{{bench.folder}/here: {bench.folder}/there}}"
        run = on_dask(f'address: "{cluster.address}", paths: {paths}')
        text = matrix(OURS, "quality, whole", run).replace("stack.npy", "here/stack.npy")
        plan = bench.plan(text)
        (bench.folder / "here").rename(bench.folder / "gone")
        summary = bench.run(plan, "dask")
    assert summary.statuses == {"ok": 4}
    assert contents(bench.store("dask"), plan) == contents(bench.store("local"), local)
    assert not list((bench.folder / "cluster").rglob("*.bits"))


def test_stop_ends_what_it_started_on_workers_that_live_on(bench: Bench) -> None:
    with cluster_elsewhere(bench.folder / "cluster", bench.site, workers=1) as cluster:
        for name in ("one", "two"):
            with started(DaskParams(address=cluster.address)) as executor:
                victim = hanging(executor, bench.folder / name)
                worker = psutil.Process(victim.ppid())
            assert gone(victim)
            assert worker.is_running()


def kill_at_random(bench: Bench, kills: int, seed: int) -> None:
    """Kill dask workers at random while a matrix runs on three of them; the table is that of a quiet run."""
    evaluators = ", ".join(f"{{use: slow, params: {{fault: '{n}'}}}}" for n in range(kills))
    local = bench.plan(matrix(f"{CODECS}, {grid('faulty', 'abcd')}", evaluators))
    bench.run(local, "local")
    rng = np.random.default_rng(seed)
    killed: list[int] = []
    earlier = psutil.Process().children(recursive=True)

    def strike(progress: Progress) -> None:
        if progress.cells_done < 7 * (len(killed) + 1) - 6 or len(killed) == kills:
            return
        workers = [one for one in spawned(earlier) if one.ppid() == os.getpid()]
        if workers:
            victim = workers[int(rng.integers(len(workers)))]
            victim.kill()
            killed.append(victim.pid)

    executor = "workers: 3, executor: {use: dask, params: {retries: 100}}"
    plan = bench.plan(matrix(f"{CODECS}, {grid('faulty', 'abcd')}", evaluators, executor))
    summary = bench.run(plan, "dask", workers=3, listener=strike)
    assert summary.statuses == {"ok": len(plan.cells)}
    assert len(killed) == kills
    assert contents(bench.store("dask"), plan) == contents(bench.store("local"), local)


@pytest.mark.slow
def test_workers_killed_at_random_change_nothing(bench: Bench) -> None:
    kill_at_random(bench, kills=4, seed=0)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_many_workers_killed_at_random_change_nothing(bench: Bench) -> None:
    kill_at_random(bench, kills=40, seed=1)


def test_a_killed_coordinator_resumes(bench: Bench) -> None:
    plan = bench.plan(matrix(OURS, "quality, whole, slow, {use: slow, params: {fault: again}}", on_dask()))
    arguments = [SUPPORT / "run_driver.py", bench.folder / "matrix.yaml", bench.folder / "killed", bench.site]
    process = subprocess.Popen([sys.executable, *map(str, arguments)])
    deadline = time.monotonic() + 60
    while len(bench.store("killed").entries()) < 2 and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.02)
    children = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
    process.kill()
    process.wait()
    finished = len(bench.store("killed").entries())
    _, alive = psutil.wait_procs(children, timeout=20)
    assert not alive
    summary = bench.run(plan, "killed")
    assert (summary.kept, summary.statuses) == (finished, {"ok": 8})
    bench.run(plan, "undisturbed")
    assert contents(bench.store("killed"), plan) == contents(bench.store("undisturbed"), plan)


def test_a_sequence_that_differs_on_the_workers_is_told(bench: Bench) -> None:
    for name in ("here", "there"):
        (bench.folder / name).mkdir()
    write_stack(bench.folder / "here" / "stack.npy", seed=0)
    write_stack(bench.folder / "there" / "stack.npy", seed=1)
    paths = f"{{{bench.folder}/here: {bench.folder}/there}}"
    text = matrix("faulty", "wandering", on_dask(f"paths: {paths}")).replace("stack.npy", "here/stack.npy")
    plan = bench.plan(text)
    bench.run(plan)
    [(_, record)] = bench.records(plan).values()
    assert record.status == "failed"
    assert "stack has changed" in record.reason


@pytest.mark.parametrize(
    ("params", "told"),
    [
        ({"options": {"surprise": 1}}, "local .*LocalCluster: TypeError"),
        ({"cluster": "ssh"}, "SSHCluster: ValueError: `hosts`"),
    ],
)
def test_a_cluster_that_cannot_be_made_is_told(params: dict[str, Any], told: str) -> None:
    with pytest.raises(CodecbenchError, match=told), started(DaskParams(**params)):
        pass


def test_a_cluster_on_this_machine_listens_on_the_loopback_alone() -> None:
    mine = psutil.Process()
    before = {process.pid for process in mine.children(recursive=True)}
    with started(DaskParams()):
        ours = [mine, *(process for process in mine.children(recursive=True) if process.pid not in before)]
        listening = {
            connection.laddr.ip
            for process in ours
            for connection in process.net_connections("inet")
            if connection.status == psutil.CONN_LISTEN
        }
    assert listening == {"127.0.0.1"}


def test_contradicting_parameters_and_unreachable_clusters_are_told() -> None:
    with pytest.raises(ValidationError, match="address, or cluster"):
        DaskParams(address="tcp://127.0.0.1:1", cluster="local")
    with (
        pytest.raises(CodecbenchError, match=r"worker at tcp://127\.0\.0\.1:9"),
        started(DaskParams(address="tcp://127.0.0.1:9", start_timeout_s=1.0)),
    ):
        pass
