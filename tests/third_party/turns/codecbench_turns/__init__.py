"""Offers the link `turns` to codecbench."""

from codecbench import PluginSpec, hookimpl


@hookimpl
def codecbench_links() -> list[PluginSpec]:
    return [PluginSpec("turns", "codecbench_turns.link:Turns", "a radio that takes turns with the other side")]
