"""Offers the executor `inline` to codecbench."""

from codecbench import PluginSpec, hookimpl


@hookimpl
def codecbench_executors() -> list[PluginSpec]:
    return [PluginSpec("inline", "codecbench_inline.executor:Inline", "tasks in the calling process, for a debugger")]
