"""Statistics of codec comparisons: BD-rates that say when they mean nothing, paired differences, Pareto fronts."""

from codecbench.core.engine.aggregate import AGGREGATES, aggregate, median_interval
from codecbench.core.results.bjontegaard import BdRate, bd_rate, bd_rate_with_interval
from codecbench.core.results.blocks import block_length
from codecbench.core.results.paired_difference import PairedDifference, paired_difference
from codecbench.core.results.pareto import pareto_front

__all__ = [
    "AGGREGATES",
    "BdRate",
    "PairedDifference",
    "aggregate",
    "bd_rate",
    "bd_rate_with_interval",
    "block_length",
    "median_interval",
    "paired_difference",
    "pareto_front",
]
