"""An ideal link, but for packets that are lost by their numbers in the order of sending."""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.plugins.links.constant import Ideal


class Losing(Ideal):
    """Loses the packets of these numbers."""

    def __init__(self, *lost: int) -> None:
        super().__init__(Ideal.params_type())
        self.lost = lost

    def open(self, rng: np.random.Generator) -> Any:
        numbers = iter(range(1000))
        channel = super().open(rng)
        whole = channel.carry
        channel.carry = lambda size, start_s: whole(size, start_s)._replace(  # type: ignore[method-assign]
            **({"arrives_s": None} if next(numbers) in self.lost else {})
        )
        return channel
