"""Offers the codec `posterize` to codecbench."""

from codecbench import PluginSpec, hookimpl


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    return [
        PluginSpec("posterize", "codecbench_posterize.codec:Posterize", "keeps the upper bits of each sample, deflated")
    ]
