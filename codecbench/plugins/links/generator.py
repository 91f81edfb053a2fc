"""Generate the embedded traces: `python -m codecbench.plugins.links.generator FOLDER`.

The model is the one by which Sprout forecasts cellular links (Winstein, Sivaraman and Balakrishnan, "Stochastic
Forecasts Achieve High Throughput and Low Delay over Cellular Networks", USENIX NSDI 2013, section 3). Packets can be
sent at the times of a Poisson process whose rate is a Brownian motion; once the rate is zero, it stays zero for an
exponential time. Deviations: the rate is an Ornstein-Uhlenbeck process, so that a trace has about the requested mean,
and outages also begin at random, so that a fast link has some.
"""

from __future__ import annotations

import gzip
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

STEP_S: Final = 0.02
"""The rate is constant during one step, as in the source."""


@dataclass(frozen=True)
class VaryingRate:
    """The parameters of a link whose rate varies."""

    mean_pps: float
    """Mean rate in packets of 1,500 bytes per second."""
    sigma: float
    """Of the Brownian motion, in packets per second per root second; 200 in the source."""
    relaxation_s: float
    """Time constant with which the rate returns to its mean."""
    outages_per_s: float
    outage_s: float
    """Mean length of an outage; 1 in the source."""
    seed: int


TRACES: Final = {
    "lte_still": VaryingRate(mean_pps=470.0, sigma=80.0, relaxation_s=2.0, outages_per_s=0.0, outage_s=0.1, seed=1),
    "lte_moving": VaryingRate(mean_pps=400.0, sigma=200.0, relaxation_s=4.0, outages_per_s=0.03, outage_s=1.0, seed=2),
    "wifi_walking": VaryingRate(mean_pps=800.0, sigma=300.0, relaxation_s=3.0, outages_per_s=0.1, outage_s=0.3, seed=3),
}
"""The embedded traces, by name. docs/link.md has their sources."""
_LENGTH_S: Final = 60.0


def trace(model: VaryingRate, length_s: float = _LENGTH_S) -> list[int]:
    """Milliseconds at which a packet can be sent, rising; the last one is the end of the trace."""
    rng = np.random.default_rng(model.seed)
    opportunities_ms: list[int] = []
    rate, out_until_s = model.mean_pps, 0.0
    for step in range(round(length_s / STEP_S)):
        now_s = step * STEP_S
        rate += (model.mean_pps - rate) * STEP_S / model.relaxation_s
        rate = max(0.0, rate + model.sigma * np.sqrt(STEP_S) * rng.standard_normal())
        begins = rate == 0.0 or rng.random() < model.outages_per_s * STEP_S
        length = rng.exponential(model.outage_s)
        if begins and now_s >= out_until_s:
            out_until_s = now_s + length
        count = rng.poisson(rate * STEP_S)
        times_ms = np.sort(1e3 * (now_s + STEP_S * rng.random(count)))
        if now_s >= out_until_s:
            opportunities_ms += times_ms.astype(int).tolist()
    return [*opportunities_ms, round(1e3 * length_s)]


def main(folder: Path) -> None:
    """Write all traces into a folder, compressed with gzip."""
    for name, model in TRACES.items():
        text = "\n".join(map(str, trace(model))) + "\n"
        (folder / f"{name}.gz").write_bytes(gzip.compress(text.encode(), mtime=0))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
