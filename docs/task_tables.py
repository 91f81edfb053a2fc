"""Codecs in order at equal rates, by the headlines of role `task` that are measured frame by frame."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from codecbench.core.results.columns import Column
from codecbench.core.results.markdown import table
from codecbench.core.results.matched_rates import Standing, order_at_rate
from codecbench.core.results.run_result import RunResult

RATES_BPP: Final = (0.35, 0.6, 1.0)
"""The rates at which examples/tasks.yaml has settings of most codecs on both sides."""


def orders(run: RunResult, heads: tuple[str, ...]) -> Iterator[str]:
    """A table for each headline of role `task`: the codecs of each rate in order, and what separates them."""
    (entry,) = run.plan.sequences
    for column in run.headlines("task"):
        yield f"**{column.label}** (`{column.evaluator.name}.{column.metric.name}`)\n"
        rows = [row for rate in RATES_BPP for row in _rows(column, rate, order_at_rate(run, column, entry.name, rate))]
        yield table(heads, rows)


def _rows(column: Column, rate: float, order: list[Standing]) -> Iterator[list[str]]:
    for standing in order:
        lead = standing.ahead
        words = ["", "", ""]
        if lead is not None:
            low, high = sorted((abs(lead.interval[0]), abs(lead.interval[1])))
            sides = "" if lead.interval[0] * lead.interval[1] > 0 else "-"
            chance = "< 0.001" if standing.p_value < 0.001 else f"{standing.p_value:.3f}"
            words = [f"{abs(lead.mean):.3g} [{sides}{low:.3g}, {high:.3g}]", chance, f"{lead.detectable:.2g}"]
        yield [f"{rate:g}", f"{standing.group + 1}", standing.curve, f"{standing.mean:.4g}", *words]
