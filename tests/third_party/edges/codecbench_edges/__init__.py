"""Offers the evaluator `edges` to codecbench."""

from codecbench import Offer, hookimpl


@hookimpl
def codecbench_evaluators() -> list[Offer]:
    return [Offer("edges", "codecbench_edges.evaluator:Edges", "what an edge detector would lose")]
