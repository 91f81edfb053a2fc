"""The executors that ship with codecbench, as references: nothing heavy is imported until a run needs it."""

from __future__ import annotations

from codecbench.core.contracts.hooks import Offer, hookimpl

_HERE = "codecbench.plugins.executors."


@hookimpl
def codecbench_executors() -> list[Offer]:
    return [
        Offer("local", _HERE + "local:LocalExecutor", "worker processes on this machine"),
        Offer(
            "dask",
            _HERE + "dask:DaskExecutor",
            "workers of a dask.distributed cluster: local, by address, over SSH, Slurm or PBS",
            requires=("distributed",),
            extra="codecbench[dask]",
        ),
    ]
