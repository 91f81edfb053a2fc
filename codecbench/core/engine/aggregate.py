"""How many values become one: the aggregates that a metric may name.

Infinite values (the PSNR of identical images) are kept apart from means: `mean` and `std` use the finite values, and
a mean is infinite only where every value is. Order statistics and the bootstrap of the median take them as they come.
Missing values (NaN) are left out; an aggregate of nothing is NaN.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric

_MOST_PICKS: Final = 4_000_000
"""Values that resampling holds at a time."""

Values = NDArray[np.float64]

BOOTSTRAP_RESAMPLES: Final = 2000
"""Resamples behind a confidence interval: the ends of a 95 % interval rest on 50 of them each."""


def mean(values: Values) -> float:
    """Arithmetic mean of the finite values."""
    return _over_finite(np.mean, values)


def std(values: Values) -> float:
    """Sample standard deviation (n - 1) of the finite values; NaN for fewer than two."""
    finite = values[np.isfinite(values)]
    return float(np.std(finite, ddof=1)) if len(finite) > 1 else float("nan")


def median(values: Values) -> float:
    """The middle value; between two middle values their mean."""
    return percentile(values, 50.0)


def p95(values: Values) -> float:
    """The 95th percentile, linear between order statistics."""
    return percentile(values, 95.0)


def iqr(values: Values) -> float:
    """Interquartile range."""
    low, high = percentile(values, 25.0), percentile(values, 75.0)
    return 0.0 if low == high else high - low


def minimum(values: Values) -> float:
    """The least value."""
    return float(values.min())


def maximum(values: Values) -> float:
    """The greatest value."""
    return float(values.max())


def total(values: Values) -> float:
    """The sum."""
    return float(values.sum())


def infinite(values: Values) -> float:
    """How many values are infinite."""
    return float(np.count_nonzero(np.isinf(values)))


def ci95_low(values: Values) -> float:
    """Lower end of the 95 % interval of the median; see `median_interval`."""
    return median_interval(values)[0]


def ci95_high(values: Values) -> float:
    """Upper end of the 95 % interval of the median; see `median_interval`."""
    return median_interval(values)[1]


def median_interval(values: Values) -> tuple[float, float]:
    """Percentile-bootstrap 95 % interval of the median; NaN for fewer than three values.

    The resampling is seeded, so that equal values give equal intervals (Efron and Tibshirani 1993, chapter 13).
    """
    if len(values) < 3:
        return float("nan"), float("nan")
    rng = np.random.default_rng(0)
    block = max(1, _MOST_PICKS // len(values))
    blocks = [min(block, BOOTSTRAP_RESAMPLES - first) for first in range(0, BOOTSTRAP_RESAMPLES, block)]
    medians = np.sort(
        np.concatenate([np.median(values[rng.integers(0, len(values), (n, len(values)))], axis=1) for n in blocks])
    )
    return percentile(medians, 2.5), percentile(medians, 97.5)


def percentile(values: Values, share: float) -> float:
    """Linear interpolation between order statistics that infinite values survive; NaN between -inf and inf."""
    ordered = np.sort(values)
    at = share / 100.0 * (len(ordered) - 1)
    low, high = ordered[int(np.floor(at))], ordered[int(np.ceil(at))]
    if low == high or (np.isneginf(low) and np.isfinite(high)):
        return float(low)
    return float(low + (high - low) * (at - np.floor(at)))


def _over_finite(function: Callable[[Values], np.floating], values: Values) -> float:
    finite = values[np.isfinite(values)]
    return float(function(finite)) if len(finite) else float(values[0])


AGGREGATES: Final[dict[str, Callable[[Values], float]]] = {
    "mean": mean,
    "std": std,
    "median": median,
    "p95": p95,
    "iqr": iqr,
    "min": minimum,
    "max": maximum,
    "sum": total,
    "infinite": infinite,
    "ci95_low": ci95_low,
    "ci95_high": ci95_high,
}


def aggregate(name: str, values: Values) -> float:
    """One aggregate of the values that are not NaN; NaN where there are none. Raises KeyError for unknown names."""
    function = AGGREGATES[name]
    present = values[~np.isnan(values)]
    return function(present) if len(present) else float("nan")


def summarise(samples: Iterable[Measurement], metrics: Iterable[Metric]) -> dict[tuple[str, str, str], float]:
    """The declared aggregates of per-frame measurements, by (metric, stage, aggregate).

    Where values are infinite, their number is added as the aggregate `infinite`. Raises OverflowError for an aggregate
    that is infinite where no value is.
    """
    declared = {metric.name: metric.aggregates for metric in metrics}
    values: dict[tuple[str, str], list[float]] = defaultdict(list)
    for sample in samples:
        values[sample.metric, sample.stage or ""].append(sample.value)
    found: dict[tuple[str, str, str], float] = {}
    for (name, stage), series in values.items():
        array, has_infinite = np.array(series, dtype=np.float64), any(map(math.isinf, series))
        for how in declared[name]:
            with np.errstate(over="ignore"):
                value = found[name, stage, how] = aggregate(how, array)
            if math.isinf(value) and not has_infinite:
                raise OverflowError(f"{name}: {how} of {len(series)} finite values is too large for a number")
        if has_infinite:
            found[name, stage, "infinite"] = aggregate("infinite", array)
    return found
