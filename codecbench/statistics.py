"""Statistics of codec comparisons: BD-rates with validity checks, paired differences, Pareto fronts."""

from codecbench.core.analysis.bjontegaard import BdRate, bd_rate
from codecbench.core.analysis.evidence import PairedDifference, paired_difference
from codecbench.core.analysis.verdicts import pareto_front
from codecbench.core.engine.storage.aggregate import AGGREGATES, aggregate, median_interval

__all__ = [
    "AGGREGATES",
    "BdRate",
    "PairedDifference",
    "aggregate",
    "bd_rate",
    "median_interval",
    "paired_difference",
    "pareto_front",
]
