"""What runs in the workers of a dask cluster: each hands its task to an isolated process of its own."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable
from functools import partial

from codecbench.core.contracts.executor import PATHS_VARIABLE, Finished
from codecbench.plugins.executors.isolation import SINGLE_THREADED
from codecbench.plugins.executors.pool import WorkerPool

_local = threading.local()
_pools: list[WorkerPool] = []
_stops = itertools.count()
_last_stop = next(_stops)


def perform_isolated(content: bytes) -> Finished:
    """Run a task in this dask worker's isolated process and wait for it."""
    task, prepare, paths = pickle.loads(content)
    begun_after = _last_stop
    pool = _pool(partial(_prepare_with, paths, prepare))
    pool.start(task)
    while (finished := pool.next_finished(1.0)) is None:
        if _last_stop != begun_after:  # also if its process was only starting when all were told to end
            pool.kill()
    return finished


def _pool(prepare: partial[None]) -> WorkerPool:
    """The pool of this thread; another one where an earlier coordinator prepared its processes otherwise."""
    wanted = pickle.dumps(prepare)
    if getattr(_local, "prepared", None) != wanted:
        if hasattr(_local, "pool"):
            _pools.remove(_local.pool)
            _local.pool.stop()
        # A dask worker may be a daemon, which Python does not allow processes of its own; ours end with it anyway.
        multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
        os.environ.update(SINGLE_THREADED)
        _local.pool, _local.prepared = WorkerPool(1, prepare, _own_folder()), wanted
        _pools.append(_local.pool)
    pool: WorkerPool = _local.pool
    return pool


def _own_folder() -> str:
    """The folder of this dask worker: dask removes it when the worker ends or, was it killed, when another begins."""
    from distributed import get_worker

    return str(get_worker().local_directory)  # type: ignore[no-untyped-call]


def _prepare_with(paths: dict[str, str], prepare: Callable[[], None]) -> None:
    """Prepare an isolated process, which is to find folders where `paths` says."""
    os.environ[PATHS_VARIABLE] = os.pathsep.join(f"{here}={there}" for here, there in paths.items())
    prepare()


async def stop_pools() -> None:
    """End the isolated processes of this dask worker, whatever they are doing; the next task starts new ones."""
    global _last_stop
    _last_stop = next(_stops)
    for pool in _pools:
        pool.kill()
