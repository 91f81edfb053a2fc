"""Statistics of codec comparisons: BD-rates that say when they mean nothing, Pareto fronts, aggregates."""

from codecbench.core.engine.aggregate import AGGREGATES, aggregate, median_interval
from codecbench.core.results.bjontegaard import BdRate, bd_rate, bd_rate_with_interval
from codecbench.core.results.pareto import pareto_front

__all__ = ["AGGREGATES", "BdRate", "aggregate", "bd_rate", "bd_rate_with_interval", "median_interval", "pareto_front"]
