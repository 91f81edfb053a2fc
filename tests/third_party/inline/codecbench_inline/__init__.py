"""Offers the executor `inline` to codecbench."""

from codecbench import Offer, hookimpl


@hookimpl
def codecbench_executors() -> list[Offer]:
    return [Offer("inline", "codecbench_inline.executor:Inline", "tasks in the calling process, for a debugger")]
