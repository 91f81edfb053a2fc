"""A radio on one frequency: it sends in the first part of each period, and listens in the rest."""

import numpy as np
from pydantic import Field

from codecbench import Channel, Link, Params, Passage, Queue


class TurnsParams(Params):
    rate_kbps: float = Field(default=250.0, gt=0, description="while it sends")
    period_ms: float = Field(default=200.0, gt=0, description="from one turn to the next")
    share: float = Field(default=0.5, gt=0, le=1, description="of the period in which it sends")
    loss: float = Field(default=0.0, ge=0, lt=1, description="share of the packets that are lost")


class Turns(Link[TurnsParams]):
    name = "turns"
    version = "1"
    params_type = TurnsParams
    delay_s = 0.001
    queue = Queue(packets=64)

    def open(self, rng: np.random.Generator) -> Channel:
        return TurnsChannel(self.params, self.delay_s, rng)


class TurnsChannel(Channel):
    def __init__(self, params: TurnsParams, delay_s: float, rng: np.random.Generator) -> None:
        self.params, self.delay_s, self.rng = params, delay_s, rng

    def carry(self, size_bytes: int, start_s: float) -> Passage:
        period_s = 1e-3 * self.params.period_ms
        turn_s, left_s = self.params.share * period_s, 8e-3 * size_bytes / self.params.rate_kbps
        now_s = start_s
        while left_s > 0:
            number = int(now_s / period_s + 1e-9)
            ends_s = number * period_s + turn_s
            sends_s = min(left_s, max(0.0, ends_s - now_s))
            left_s -= sends_s
            now_s = now_s + sends_s if left_s <= 1e-12 else (number + 1) * period_s
            left_s = left_s if left_s > 1e-12 else 0.0
        is_lost = self.rng.random() < self.params.loss
        return Passage(now_s, None if is_lost else now_s + self.delay_s)
