"""Links that are the same at all times: `ideal`, and `constant` with a rate, a delay, jitter and independent losses."""

from __future__ import annotations

import numpy as np

from codecbench.core.contracts.link import Channel, Link, Passage
from codecbench.core.contracts.params import NoParams
from codecbench.plugins.links.queued import Flight, RadioLink, RadioParams, Share, random_numbers


class Ideal(Link[NoParams]):
    """Delivers every packet at once and loses none."""

    name = "ideal"
    version = "1"
    params_type = NoParams

    def open(self, rng: np.random.Generator) -> Channel:
        return _IdealChannel()


class _IdealChannel(Channel):
    def carry(self, size_bytes: int, start_s: float) -> Passage:
        return Passage(start_s, start_s)


class ConstantParams(RadioParams):
    """Set the loss of a radio; see also RadioParams.

    loss: probability that a packet is lost, independent of the others.
    """

    loss: Share = 0.0


class Constant(RadioLink[ConstantParams]):
    """Sends at a constant rate and loses packets independently of each other."""

    name = "constant"
    version = "1"
    params_type = ConstantParams

    def open(self, rng: np.random.Generator) -> Channel:
        return _ConstantChannel(self.params, rng)


class _ConstantChannel(Channel):
    def __init__(self, params: ConstantParams, rng: np.random.Generator) -> None:
        loss_rng, jitter_rng = rng.spawn(2)
        self._seconds_per_byte = 8e-3 / params.rate_kbps
        self._loss, self._draws = params.loss, random_numbers(loss_rng.random)
        self._flight = Flight(params.delay_ms, params.jitter_ms, params.jitter, jitter_rng)

    def carry(self, size_bytes: int, start_s: float) -> Passage:
        sent_s = start_s + size_bytes * self._seconds_per_byte
        if self._loss and next(self._draws) < self._loss:
            return Passage(sent_s, None)
        return Passage(sent_s, sent_s + self._flight.duration_s())
