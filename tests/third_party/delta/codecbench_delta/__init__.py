"""Offers the codec `delta` to codecbench."""

from codecbench import PluginSpec, hookimpl


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    return [PluginSpec("delta", "codecbench_delta.codec:Delta", "differences between pictures, deflated")]
