"""Offers the evaluator `edges` to codecbench."""

from codecbench import PluginSpec, hookimpl


@hookimpl
def codecbench_evaluators() -> list[PluginSpec]:
    return [PluginSpec("edges", "codecbench_edges.evaluator:Edges", "what an edge detector would lose")]
