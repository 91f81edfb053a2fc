"""The executors that ship with codecbench, by reference, so that nothing heavy is imported until a run needs it."""

from __future__ import annotations

from codecbench.core.contracts.hooks import PluginSpec, hookimpl

_HERE = "codecbench.plugins.executors."


@hookimpl
def codecbench_executors() -> list[PluginSpec]:
    return [
        PluginSpec("local", _HERE + "local:LocalExecutor", "worker processes on this machine"),
        PluginSpec(
            "dask",
            _HERE + "dask:DaskExecutor",
            "workers of a dask.distributed cluster: local, by address, over SSH, Slurm or PBS",
            requires=("distributed",),
            extra="codecbench[dask]",
        ),
    ]
