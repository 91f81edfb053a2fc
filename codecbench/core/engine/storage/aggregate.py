"""Aggregates that a metric may name: each turns many values into one.

Infinite values (the PSNR of identical images) are excluded from `mean` and `std`; a mean is infinite only if every
value is. Order statistics and the bootstrap of the median use them as they are. Missing values (NaN) are ignored; an
aggregate of no values is NaN.
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
"""Maximum number of resampled values in memory at a time."""

Values = NDArray[np.float64]

BOOTSTRAP_RESAMPLES: Final = 2000
"""Resamples behind a confidence interval: 50 of them lie beyond each end of a 95 % interval."""


def median_interval(values: Values) -> tuple[float, float]:
    """Return the percentile-bootstrap 95 % interval of the median; NaN for fewer than three values.

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


def percentile(values: Values, percent: float) -> float:
    """Interpolate linearly between order statistics, which may be infinite; NaN between -inf and inf."""
    ordered = np.sort(values)
    position = percent / 100.0 * (len(ordered) - 1)
    low, high = ordered[int(np.floor(position))], ordered[int(np.ceil(position))]
    if low == high or (np.isneginf(low) and np.isfinite(high)):
        return float(low)
    return float(low + (high - low) * (position - np.floor(position)))


def _mean(values: Values) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else float(values[0])


def _std(values: Values) -> float:
    """Return the standard deviation with n - 1; NaN for fewer than two values."""
    finite = values[np.isfinite(values)]
    return float(np.std(finite, ddof=1)) if len(finite) > 1 else float("nan")


def _iqr(values: Values) -> float:
    low, high = percentile(values, 25.0), percentile(values, 75.0)
    return 0.0 if low == high else high - low


AGGREGATES: Final[dict[str, Callable[[Values], float]]] = {
    "mean": _mean,
    "std": _std,
    "median": lambda values: percentile(values, 50.0),
    "p95": lambda values: percentile(values, 95.0),
    "iqr": _iqr,
    "min": lambda values: float(values.min()),
    "max": lambda values: float(values.max()),
    "sum": lambda values: float(values.sum()),
    "infinite": lambda values: float(np.count_nonzero(np.isinf(values))),
    "ci95_low": lambda values: median_interval(values)[0],
    "ci95_high": lambda values: median_interval(values)[1],
}


def aggregate(name: str, values: Values) -> float:
    """Return one aggregate of the values that are not NaN; NaN if there are none. Raises KeyError for unknown names."""
    function = AGGREGATES[name]
    present = values[~np.isnan(values)]
    return function(present) if len(present) else float("nan")


def summarise(samples: Iterable[Measurement], metrics: Iterable[Metric]) -> dict[tuple[str, str, str], float]:
    """Return the declared aggregates of per-frame measurements, by (metric, stage, aggregate).

    If values are infinite, their number is added as the aggregate `infinite`. Raises OverflowError for an aggregate
    that is infinite though no value is.
    """
    declared = {metric.name: metric.aggregates for metric in metrics}
    values: dict[tuple[str, str], list[float]] = defaultdict(list)
    for sample in samples:
        values[sample.metric, sample.stage or ""].append(sample.value)
    summaries: dict[tuple[str, str, str], float] = {}
    for (name, stage), series in values.items():
        array, has_infinite = np.array(series, dtype=np.float64), any(map(math.isinf, series))
        for aggregate_name in declared[name]:
            with np.errstate(over="ignore"):
                value = summaries[name, stage, aggregate_name] = aggregate(aggregate_name, array)
            if math.isinf(value) and not has_infinite:
                raise OverflowError(
                    f"{name}: {aggregate_name} of {len(series)} finite values is too large for a number"
                )
        if has_infinite:
            summaries[name, stage, "infinite"] = aggregate("infinite", array)
    return summaries
