"""The link `ideal`: everything arrives at once."""

from __future__ import annotations

import numpy as np

from codecbench.core.contracts.link import Channel, Link, Passage
from codecbench.core.contracts.params import NoParams


class Ideal(Link[NoParams]):
    """No packet waits, travels or is lost."""

    name = "ideal"
    version = "1"
    params_type = NoParams

    def open(self, rng: np.random.Generator) -> Channel:
        return _IdealChannel()


class _IdealChannel(Channel):
    def carry(self, size_bytes: int, start_s: float) -> Passage:
        return Passage(start_s, start_s)
