"""Base classes of links with a delay and a queue, their random numbers and the travel time of packets."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Annotated, Final, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.link import Discipline, Link, Queue
from codecbench.core.contracts.params import Params

_BLOCK: Final = 1024
"""Drawing this many at once takes a tenth of the time of drawing them one by one."""

Share = Annotated[float, Field(ge=0.0, lt=1.0)]
Time = Annotated[float, Field(ge=0.0)]
Duration = Annotated[float, Field(gt=0.0)]
Distribution = Literal["exponential", "uniform"]


class QueuedParams(Params):
    """Set the delay and the queue of a link.

    delay_ms: one-way delay. queue: discipline of the queue. queue_packets: most packets that wait in it.
    """

    delay_ms: Time = 0.0
    queue: Discipline = "drop_tail"
    queue_packets: Annotated[int, Field(ge=1)] = 256


class RadioParams(QueuedParams):
    """Set the rate and the jitter of a radio; see also QueuedParams.

    rate_kbps: rate in units of 1,000 bits per second. jitter_ms: mean of the jitter, which is added to the delay of
    each packet. jitter: its distribution, `exponential`, or `uniform` from 0 to twice the mean.
    """

    rate_kbps: Duration
    jitter_ms: Time = 0.0
    jitter: Distribution = "exponential"


Q = TypeVar("Q", bound=QueuedParams)
R = TypeVar("R", bound=RadioParams)


class QueuedLink(Link[Q]):
    """A link with the delay and the queue of its parameters."""

    @property
    def delay_s(self) -> float:
        return 1e-3 * self.params.delay_ms

    @property
    def queue(self) -> Queue:
        return Queue(self.params.queue_packets, self.params.queue)


class RadioLink(QueuedLink[R]):
    """A link at a rate, whose packets overtake each other if there is jitter."""

    @property
    def keeps_order(self) -> bool:
        return self.params.jitter_ms == 0.0


def random_numbers(draw: Callable[[int], NDArray[np.float64]]) -> Iterator[float]:
    """Yield numbers without end from a method of a generator, such as `rng.random`."""
    while True:
        yield from draw(_BLOCK).tolist()


class Flight:
    """The travel time of packets: a delay and jitter."""

    def __init__(self, delay_ms: float, jitter_ms: float, jitter: Distribution, rng: np.random.Generator) -> None:
        self._delay_s = 1e-3 * delay_ms
        self._jitter_s = 1e-3 * jitter_ms if jitter == "exponential" else 2e-3 * jitter_ms
        self._draws = random_numbers(rng.standard_exponential if jitter == "exponential" else rng.random)

    def duration_s(self) -> float:
        """The travel time of the next packet."""
        return self._delay_s + self._jitter_s * next(self._draws) if self._jitter_s else self._delay_s
