"""The dask executor runs tasks on the workers of a dask.distributed cluster.

A dask worker hands each task to an isolated process of its own (see `pool`), so that a codec that crashes, hangs or
uses too much memory costs its cell and not the worker. If a worker dies as a whole, for instance with its host, its
tasks are retried elsewhere, up to `retries` times. Only the coordinator writes to the run folder.
"""

from __future__ import annotations

import importlib
import itertools
import logging
import pickle
import queue
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, Self

from pydantic import Field, model_validator

from codecbench.core.contracts.errors import CodecbenchError, Unsupported
from codecbench.core.contracts.executor import Executor, Finished, Task
from codecbench.core.contracts.params import Params
from codecbench.plugins.executors.dask_worker import perform_isolated, stop_pools
from codecbench.plugins.executors.fork_server import hide_main

log = logging.getLogger("codecbench.dask")

_CLUSTERS: Final = {
    "local": ("distributed", "LocalCluster", "codecbench[dask]"),
    "ssh": ("distributed", "SSHCluster", "codecbench[dask] asyncssh"),
    "slurm": ("dask_jobqueue", "SLURMCluster", "dask-jobqueue"),
    "pbs": ("dask_jobqueue", "PBSCluster", "dask-jobqueue"),
}
_SEND_DIRECTLY_BYTES: Final = 1 << 20
"""Larger tasks bypass the scheduler, which would otherwise hold them all in memory."""

_CLOSE_S: Final = 20.0

_LOOK_EVERY_S: Final = 5.0
"""Interval between checks of the number of workers."""


class DaskParams(Params):
    """Set the cluster that runs the tasks.

    Without `address`, the run makes a cluster of the kind `cluster`, with `options` as keyword arguments of its class,
    and closes it at its end.
    """

    cluster: Literal["local", "ssh", "slurm", "pbs"] | None = Field(
        None, description="kind of cluster to make; default: local"
    )
    options: dict[str, Any] = Field(
        default_factory=dict, description="keyword arguments of LocalCluster, SSHCluster and so on"
    )
    address: str | None = Field(None, description="scheduler of an existing cluster, tcp://host:port")
    shared_files: bool | None = Field(
        None, description="workers see the run folder under the same path; default: yes for a local cluster only"
    )
    paths: dict[str, str] = Field(
        default_factory=dict, description="folders of sequences on this machine, each with its path on workers"
    )
    retries: int = Field(2, ge=0, description="how often to retry a task after its worker dies")
    start_timeout_s: float = Field(600.0, gt=0, description="longest wait for the first worker, in seconds")

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if self.address is not None and (self.cluster is not None or self.options):
            raise ValueError("give either address, or cluster with its options")
        return self

    @property
    def cluster_kind(self) -> str:
        """The kind of cluster to make if there is no address."""
        return self.cluster or "local"


class DaskExecutor(Executor[DaskParams]):
    """Runs tasks on a dask.distributed cluster.

    Exclusive tasks wait until nothing else runs. Then they run one at a time, all on the same worker, so that times are
    of one machine and no other task disturbs them.
    """

    name = "dask"
    version = "1"
    params_type: ClassVar[type[Params]] = DaskParams

    def __init__(self, params: DaskParams) -> None:
        super().__init__(params)
        local = params.address is None and params.cluster_kind == "local"
        self.shares_files = local if params.shared_files is None else params.shared_files
        self._cluster: Any = None
        self._client: Any = None
        self._prepare: Callable[[], None] | None = None
        self._running: dict[str, _Submission] = {}
        self._waiting: deque[Task] = deque()
        self._alone = False
        self._done: queue.Queue[tuple[str, Any]] = queue.Queue()
        self._numbers = itertools.count()
        self._stopping = False
        self._worker_count = 0
        self._checked_at = self._last_seen = 0.0

    def start(self, workers: int, prepare: Callable[[], None]) -> None:
        import dask  # an optional extra
        from distributed import Client

        self._prepare = prepare
        settings = {"distributed.worker.daemon": False, "distributed.admin.low-level-log-length": 0}
        with dask.config.set(settings):
            if self.params.address is None:
                self._cluster = self._make_cluster(workers)
            try:
                where = self._cluster or self.params.address
                self._client = Client(where, timeout=self.params.start_timeout_s)  # type: ignore[no-untyped-call]
                self._client.wait_for_workers(1, timeout=self.params.start_timeout_s)
            except (OSError, TypeError, ValueError) as error:  # TimeoutError is an OSError; settings raise the others
                place = self.params.address or f"the {self.params.cluster_kind} cluster"
                cause = error if isinstance(error, OSError) else OSError(str(error))
                raise CodecbenchError(f"no dask worker at {place}: {error}") from cause
        self._worker_count = len(self._cluster.worker_spec) if self._cluster is not None else 0
        self._checked_at = self._last_seen = time.monotonic()
        self._client.run_on_scheduler(_allow_failures, count=self.params.retries)

    def submit(self, task: Task) -> None:
        self._waiting.append(task)
        self._fill()

    def next_finished(self, timeout_s: float) -> Finished | None:
        self._check_workers()
        try:
            task_id, future = self._done.get(timeout=timeout_s) if timeout_s > 0 else self._done.get_nowait()
        except queue.Empty:
            return None
        submission = self._running[task_id]
        finished = _outcome(task_id, future)
        if finished is None and submission.attempt <= self.params.retries:
            self._send(submission.task, submission.attempt + 1)
            return None
        del self._running[task_id]
        self._fill()
        return finished or Finished(task_id, "crashed", reason="the cluster lost its result with the worker")

    def stop(self) -> None:
        self._stopping = True
        self._waiting.clear()
        client, self._client = self._client, None
        cluster, self._cluster = self._cluster, None
        if client is not None:
            with suppress(OSError, RuntimeError):
                client.cancel([submission.future for submission in self._running.values()], force=True)
                client.run(stop_pools, wait=False, on_error="ignore")
        for connection in (client, cluster):
            if connection is not None:
                _close(connection)
        self._running.clear()

    def _make_cluster(self, workers: int) -> Any:
        module, name, requirement = _CLUSTERS[self.params.cluster_kind]
        try:
            make = getattr(importlib.import_module(module), name)
        except ImportError as error:
            message = f"cluster: {self.params.cluster_kind} needs {module}, which is not installed"
            raise Unsupported(f"{message}; run: pip install {requirement}") from error
        defaults: dict[str, Any] = {}
        if self.params.cluster_kind == "local":
            defaults = {"n_workers": workers, "threads_per_worker": 1, "processes": True, "memory_limit": 0}
            defaults["dashboard_address"] = "127.0.0.1:0"  # not all interfaces, and any free port
        try:
            with hide_main():
                cluster = make(**{**defaults, **self.params.options})
            if self.params.cluster_kind in ("slurm", "pbs"):
                cluster.scale(jobs=workers)
        except (OSError, RuntimeError, TypeError, ValueError, ImportError) as error:
            cause: BaseException = error
            while cause.__cause__ is not None:
                cause = cause.__cause__
            reason = f"{type(cause).__name__}: {cause}"
            raise CodecbenchError(
                f"cannot make the {self.params.cluster_kind} cluster with {name}: {reason}"
            ) from error
        return cluster

    def _fill(self) -> None:
        """Submit waiting tasks to the cluster, in order, as far as exclusive tasks allow."""
        while self._waiting:
            if self._running and (self._alone or self._waiting[0].exclusive):
                return
            task = self._waiting.popleft()
            self._alone = task.exclusive
            self._send(task)

    def _send(self, task: Task, attempt: int = 1) -> None:
        assert self._client is not None
        content: Any = pickle.dumps((task, self._prepare, self.params.paths))
        if len(content) > _SEND_DIRECTLY_BYTES:
            content = self._client.scatter(content, hash=False)
        first = self._timing_worker() if task.exclusive else None
        where = {"workers": [first], "allow_other_workers": True} if first else {}
        key = f"codecbench-{task.id}-{next(self._numbers)}"
        future = self._client.submit(perform_isolated, content, key=key, pure=False, **where)
        self._running[task.id] = _Submission(task, future, content, attempt)
        future.add_done_callback(lambda done: None if self._stopping else self._done.put((task.id, done)))

    def _check_workers(self) -> None:
        """Restart dead workers of our own cluster; raise CodecbenchError if there is none for too long.

        A dask nanny restarts its worker itself, unless the worker is killed while it starts.
        """
        now = time.monotonic()
        if now - self._checked_at < _LOOK_EVERY_S:
            return
        self._checked_at = now
        present = len(self._client.nthreads())
        if present:
            self._last_seen = now
        elif now - self._last_seen > self.params.start_timeout_s:
            place = self.params.address or f"the {self.params.cluster_kind} cluster"
            message = f"no dask worker at {place} for {self.params.start_timeout_s:g} s"
            raise CodecbenchError(f"{message}; finished work is kept: fix this and run again")
        if self._cluster is not None and present < self._worker_count:
            self._cluster.scale(self._worker_count)

    def _timing_worker(self) -> str | None:
        """The worker for exclusive tasks: always the first by name; None if there is no worker."""
        workers = self._client.scheduler_info(n_workers=-1)["workers"]
        return min(workers, key=lambda address: (str(workers[address]["name"]), address), default=None)


@dataclass(frozen=True)
class _Submission:
    """A task on the cluster."""

    task: Task
    future: Any
    content: Any
    """The pickled task; the reference keeps the cluster from dropping it."""
    attempt: int


def _outcome(task_id: str, future: Any) -> Finished | None:
    """The result of a finished future: its value, the death of its workers, or None if it was lost."""
    if future.status == "finished":
        with suppress(OSError):  # the worker may die before it transfers the result
            return future.result()  # type: ignore[no-any-return]
    if future.status != "error":
        return None
    error = future.exception()
    text = " ".join(f"{type(error).__name__}: {error}".split())
    if type(error).__name__ == "KilledWorker":
        text = f"every worker that tried it died ({text})"
    return Finished(task_id, "crashed", reason=text)


def _close(connection: Any) -> None:
    """Close a client or a cluster; on a busy machine that can take longer than a run should wait."""
    try:
        connection.close(timeout=_CLOSE_S)
    except (OSError, RuntimeError) as error:
        log.warning("dask's %s did not close and ends with this process: %s", type(connection).__name__, error)


def _allow_failures(dask_scheduler: Any, count: int) -> None:
    """Set, on the scheduler, how many workers may die of a task before it is given up."""
    dask_scheduler.allowed_failures = count
