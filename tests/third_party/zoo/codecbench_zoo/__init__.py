"""Plugins that misbehave wherever codecbench runs code of others."""

from codecbench import PluginSpec, hookimpl


def _specs(module: str, *classes: str) -> list[PluginSpec]:
    return [PluginSpec(name.lower(), f"codecbench_zoo.{module}:{name}", f"misbehaves: {name}") for name in classes]


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    codecs = ("Exits", "Leaves", "Raises", "Hangs", "Vague", "Odd", "Cleans", "Patches", "Shadows", "Rounds", "Printed")
    return [*_specs("codecs", *codecs), *_specs("gone", "Gone"), *_specs("exiting", "Exiting")]


@hookimpl
def codecbench_datasets() -> list[PluginSpec]:
    return _specs("datasets", "Broken", "Abandoned", "Nameless")


@hookimpl
def codecbench_evaluators() -> list[PluginSpec]:
    return _specs("evaluators", "Comparing", "Quitting", "Uncertain")
