"""Makes the traces that ship: `python -m codecbench.plugins.links.generator FOLDER`.

The model is the one by which Sprout forecasts cellular links (Winstein, Sivaraman and Balakrishnan, "Stochastic
Forecasts Achieve High Throughput and Low Delay over Cellular Networks", USENIX NSDI 2013, section 3): packets can go
at the times of a Poisson process whose rate wanders in Brownian motion, and which, once it has come to nothing, stays
there for an exponential time. Deviation: the rate is drawn back to its mean, as an Ornstein-Uhlenbeck process, so that
a trace has about the mean that is asked for; outages begin by chance too, so that a fast link has some.
"""

from __future__ import annotations

import gzip
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

STEP_S: Final = 0.02
"""The rate is constant for so long, as in the source."""


@dataclass(frozen=True)
class Wander:
    """A link whose rate wanders.

    mean_pps: packets of 1,500 bytes a second. sigma: of the Brownian motion, packets a second for the root of a second;
    200 in the source. relaxation_s: in which the rate comes back to its mean. outages_per_s: how often one begins.
    outage_s: its mean length; 1 in the source.
    """

    mean_pps: float
    sigma: float
    relaxation_s: float
    outages_per_s: float
    outage_s: float
    seed: int


TRACES: Final = {
    "lte_still": Wander(mean_pps=470.0, sigma=80.0, relaxation_s=2.0, outages_per_s=0.0, outage_s=0.1, seed=1),
    "lte_moving": Wander(mean_pps=400.0, sigma=200.0, relaxation_s=4.0, outages_per_s=0.03, outage_s=1.0, seed=2),
    "wifi_walking": Wander(mean_pps=800.0, sigma=300.0, relaxation_s=3.0, outages_per_s=0.1, outage_s=0.3, seed=3),
}
"""The traces that ship, by name. docs/link.md says after whom."""
_LENGTH_S: Final = 60.0


def trace(model: Wander, length_s: float = _LENGTH_S) -> list[int]:
    """Milliseconds at which a packet can go, rising, the last of them where the trace ends."""
    rng = np.random.default_rng(model.seed)
    found: list[int] = []
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
            found += times_ms.astype(int).tolist()
    return [*found, round(1e3 * length_s)]


def main(folder: Path) -> None:
    """Write all traces into a folder, each as small as gzip makes it."""
    for name, model in TRACES.items():
        text = "\n".join(map(str, trace(model))) + "\n"
        (folder / f"{name}.gz").write_bytes(gzip.compress(text.encode(), mtime=0))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
