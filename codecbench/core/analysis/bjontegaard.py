"""BD-rate, with a reason in place of a number when the curves allow no meaningful one.

Source: G. Bjontegaard, VCEG-M33, 2001 (the idea) and VCEG-AI11, 2008 (limits); interpolation by PCHIP
(Fritsch and Carlson, doi:10.1137/0717021) as in later practice.
The reason is our only deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy
from numpy.typing import ArrayLike, NDArray

_LEAST_POINTS: Final = 3
"""Points of a curve below which PCHIP has nothing to interpolate sensibly."""

LEAST_OVERLAP: Final = 0.25
"""Share of the smaller quality range that both curves must cover; below it the ends decide everything."""


@dataclass(frozen=True)
class BdRate:
    """How much more rate a test codec needs than an anchor for the same quality, on average."""

    percent: float
    """Negative if the test codec is better; NaN if there is a `reason`."""
    overlap: float
    """Share of the smaller quality range that both curves cover."""
    reason: str = ""
    """Why there is no BD-rate."""
    failures: tuple[int, int] = (0, 0)
    """Settings without any quality, (anchor, test)."""

    def __str__(self) -> str:
        return f"no BD-rate: {self.reason}" if self.reason else f"{self.percent:+.1f} %"


def bd_rate(
    anchor_rates: ArrayLike, anchor_qualities: ArrayLike, test_rates: ArrayLike, test_qualities: ArrayLike
) -> BdRate:
    """Compute the average rate difference of two rate-quality curves over the qualities that both reach.

    Rates are positive, in any unit. Qualities are better when higher (negate an error or take its -log). NaN marks a
    setting that failed: it is counted, and its curve ends before it. A curve that is not monotone gets a reason.
    """
    curves = [_curve(anchor_rates, anchor_qualities, "anchor"), _curve(test_rates, test_qualities, "test")]
    failures = (curves[0].failures, curves[1].failures)
    low = max(curve.qualities.min() if len(curve.rates) else np.inf for curve in curves)
    high = min(curve.qualities.max() if len(curve.rates) else -np.inf for curve in curves)
    with np.errstate(invalid="ignore"):  # of infinite qualities, which are at fault
        spans = [np.ptp(curve.qualities) if len(curve.rates) else 0.0 for curve in curves]
        overlap = max(0.0, float((high - low) / min(spans))) if min(spans) > 0 else 0.0
    reason = next(filter(None, (curve.fault() for curve in curves)), "") or _overlap_fault(overlap, low, high)
    if reason:
        return BdRate(float("nan"), overlap, reason, failures)

    areas = [scipy.interpolate.PchipInterpolator(c.qualities, np.log10(c.rates)).antiderivative() for c in curves]
    anchor, test = (float(area(high) - area(low)) for area in areas)
    percent = 100.0 * (10.0 ** ((test - anchor) / (high - low)) - 1.0)
    return BdRate(float(percent), overlap, "", failures)


@dataclass(frozen=True)
class _Curve:
    """Points in order of rate, without the failed ones."""

    side: str
    """`anchor` or `test`."""
    rates: NDArray[np.float64]
    qualities: NDArray[np.float64]
    failures: int

    def fault(self) -> str:
        """Say why these points give no curve; empty if they give one."""
        if np.isnan(self.rates).any():
            return f"the {self.side} curve has a setting of unknown rate"
        if not (np.isfinite(self.qualities).all() and np.isfinite(self.rates).all()):
            return f"the {self.side} curve has an infinite value (lossless settings cannot be placed on it)"
        if len(self.rates) < _LEAST_POINTS:
            failed = f", {self.failures} failed" if self.failures else ""
            return f"the {self.side} curve has {len(self.rates)} usable points{failed}; pchip needs {_LEAST_POINTS}"
        if (self.rates <= 0).any():
            return f"the {self.side} curve has a rate that is not positive"
        for index in range(1, len(self.rates)):
            if self.rates[index] <= self.rates[index - 1] or self.qualities[index] <= self.qualities[index - 1]:
                first, second = self.qualities[index - 1], self.qualities[index]
                return (
                    f"the {self.side} curve is not monotone: from rate {self.rates[index - 1]:g} "
                    f"to {self.rates[index]:g}, quality goes from {first:g} to {second:g}"
                )
        return ""


def _curve(rates: ArrayLike, qualities: ArrayLike, side: str) -> _Curve:
    x, y = np.asarray(rates, dtype=np.float64), np.asarray(qualities, dtype=np.float64)
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"{side}: rates and qualities must be two lists of one length; got {x.shape}, {y.shape}")
    failed = np.isnan(y)
    x, y = x[~failed], y[~failed]
    order = np.lexsort((y, x))
    return _Curve(side, x[order], y[order], int(failed.sum()))


def _overlap_fault(overlap: float, low: float, high: float) -> str:
    """Say why the curves overlap too little; empty if they overlap enough."""
    if high <= low:
        return f"the curves share no quality: one ends at {high:g}, the other begins at {low:g}"
    if overlap < LEAST_OVERLAP:
        share = f"the curves share only {100 * overlap:.0f} % of the smaller quality range"
        return f"{share}; at least {100 * LEAST_OVERLAP:.0f} % is needed"
    return ""
