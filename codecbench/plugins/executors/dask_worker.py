"""Code for the workers of a dask cluster: each hands its task to an isolated process of its own."""

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
    stop_before = _last_stop
    pool = _pool(partial(_prepare_with, paths, prepare))
    pool.start(task)
    while (finished := pool.next_finished(1.0)) is None:
        if _last_stop != stop_before:  # its process may have been starting when all were killed
            pool.kill()
    return finished


def _pool(prepare: partial[None]) -> WorkerPool:
    """The pool of this thread; a new one if an earlier coordinator prepared its processes differently."""
    preparation = pickle.dumps(prepare)
    if getattr(_local, "preparation", None) != preparation:
        if hasattr(_local, "pool"):
            _pools.remove(_local.pool)
            _local.pool.stop()
        # A dask worker may be a daemon, which Python forbids to start processes; ours end with it anyway.
        multiprocessing.current_process()._config["daemon"] = False  # type: ignore[attr-defined]
        os.environ.update(SINGLE_THREADED)
        _local.pool, _local.preparation = WorkerPool(1, prepare, _local_folder()), preparation
        _pools.append(_local.pool)
    pool: WorkerPool = _local.pool
    return pool


def _local_folder() -> str:
    """The folder of this dask worker. Dask removes it when the worker ends, or after a kill when another starts."""
    from distributed import get_worker  # an optional extra

    return str(get_worker().local_directory)  # type: ignore[no-untyped-call]


def _prepare_with(paths: dict[str, str], prepare: Callable[[], None]) -> None:
    """Prepare an isolated process, which finds folders by `paths`."""
    os.environ[PATHS_VARIABLE] = os.pathsep.join(f"{here}={there}" for here, there in paths.items())
    prepare()


async def stop_pools() -> None:
    """Kill the isolated processes of this dask worker; the next task starts new ones."""
    global _last_stop
    _last_stop = next(_stops)
    for pool in _pools:
        pool.kill()
