"""Plugins that misbehave wherever codecbench runs code of others; `cases` says what each may cost."""

from codecbench import PluginSpec, hookimpl
from codecbench_zoo.cases import cases


def _specs(kind: str) -> list[PluginSpec]:
    return [PluginSpec(case.name, case.target, case.summary) for case in cases(kind)]


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    return _specs("codec")


@hookimpl
def codecbench_datasets() -> list[PluginSpec]:
    return _specs("dataset")


@hookimpl
def codecbench_evaluators() -> list[PluginSpec]:
    return _specs("evaluator")


@hookimpl
def codecbench_slam_backends() -> list[PluginSpec]:
    return _specs("slam_backend")


@hookimpl
def codecbench_executors() -> list[PluginSpec]:
    return _specs("executor")
