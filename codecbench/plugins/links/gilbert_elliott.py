"""The link `gilbert_elliott`: packets lost in bursts.

Source: Elliott, Bell System Technical Journal 42(5), 1963, doi:10.1002/j.1538-7305.1963.tb00955.x, after Gilbert 1960.
Deviation: the two states last for exponential times, not for numbers of packets, because the length of a fade does not
depend on what is sent. So every codec meets the same fades.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from codecbench.core.contracts.link import Channel, Passage
from codecbench.plugins.links.queued import Duration, Flight, RadioLink, RadioParams, Share, random_numbers


class GilbertElliottParams(RadioParams):
    """Set the two states of a radio; see also RadioParams.

    good_ms, bad_ms: mean durations of the states. good_loss, bad_loss: probability that a packet is lost in each.
    """

    good_ms: Duration
    bad_ms: Duration
    good_loss: Share = 0.0
    bad_loss: float = Field(default=1.0, ge=0.0, le=1.0)


class GilbertElliott(RadioLink[GilbertElliottParams]):
    """Alternates between a good state and a bad one, in which packets are likely to be lost."""

    name = "gilbert_elliott"
    version = "1"
    params_type = GilbertElliottParams

    def open(self, rng: np.random.Generator) -> Channel:
        return _GilbertElliottChannel(self.params, rng)


class _GilbertElliottChannel(Channel):
    """Begins in a random state, with the probability of its share of the time."""

    def __init__(self, params: GilbertElliottParams, rng: np.random.Generator) -> None:
        self._fade_rng, loss_rng, jitter_rng = rng.spawn(3)
        self._draws = random_numbers(loss_rng.random)
        self._seconds_per_byte = 8e-3 / params.rate_kbps
        self._means_s = (1e-3 * params.good_ms, 1e-3 * params.bad_ms)
        self._losses = (params.good_loss, params.bad_loss)
        self._flight = Flight(params.delay_ms, params.jitter_ms, params.jitter, jitter_rng)
        self._state = int(self._fade_rng.random() * sum(self._means_s) >= self._means_s[0])
        self._until_s = self._draw_duration_s()

    def carry(self, size_bytes: int, start_s: float) -> Passage:
        sent_s = start_s + size_bytes * self._seconds_per_byte
        while self._until_s <= sent_s:
            self._state = 1 - self._state
            self._until_s += self._draw_duration_s()
        if next(self._draws) < self._losses[self._state]:
            return Passage(sent_s, None)
        return Passage(sent_s, sent_s + self._flight.duration_s())

    def _draw_duration_s(self) -> float:
        return self._means_s[self._state] * float(self._fade_rng.exponential())
