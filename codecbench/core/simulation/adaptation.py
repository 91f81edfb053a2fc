"""Pictures that are coded as coarsely as the link asks."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Final

from pydantic import ValidationError

from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.simulation.settings import Adaptation

WINDOW_S: Final = 1.0
"""So far back the sender looks at what the link gave."""
FILL: Final = 0.9
"""Share of that which a picture may take: the rest is for headers, and for what the next second may not give."""
_STEPS: Final = 64
"""Values of a range whose ends are not whole numbers."""


class Throughput:
    """What a link gives: bytes over the time in which it was sending."""

    def __init__(self) -> None:
        self._sent: deque[tuple[float, int, float]] = deque()
        self._last_s = 0.0
        self._known: float | None = None

    def add(self, size_bytes: int, turn_s: float, sent_s: float) -> None:
        """A packet whose turn was at `turn_s` or when the last one had left, and which has left at `sent_s`."""
        self._sent.append((sent_s, size_bytes, sent_s - max(turn_s, self._last_s)))
        self._last_s = sent_s

    def at(self, now_s: float) -> float | None:
        """Bytes a second of what has left in the last second, or before where nothing has; None before anything has."""
        while self._sent and self._sent[0][0] <= now_s - WINDOW_S:
            self._sent.popleft()
        seen = [(size_bytes, busy_s) for sent_s, size_bytes, busy_s in self._sent if sent_s <= now_s]
        if seen:
            busy_s = sum(busy_s for _, busy_s in seen)
            self._known = sum(size_bytes for size_bytes, _ in seen) / busy_s if busy_s > 0.0 else math.inf
        return self._known


class AdaptiveEncoder:
    """Codes each picture as finely as fits, between the ends of a range.

    bitstreams: of the frames that were coded. Raises Unsupported for codecs with memory and for a parameter or a range
    that the codec does not take.
    """

    def __init__(self, coded: CodedSequence, adaptation: Adaptation) -> None:
        codec = coded.codec
        if not isinstance(codec, Codec):
            raise Unsupported(f"adapt is for codecs of single pictures; {codec.name} has memory and a rate of its own")
        self._sequence = coded.sequence
        self._codecs = [_variant(codec, adaptation.parameter, value) for value in _values(adaptation)]
        self.bitstreams: dict[int, bytes] = {}

    def encode(self, frame: int, budget_bytes: float | None) -> int:
        """The size of a frame's bitstream: of the finest that fits a budget, else of the coarsest.

        By bisection, as if finer were never smaller.
        """
        image = self._sequence.read(frame).image
        low, high = 0, len(self._codecs) - 1
        best = self._codecs[0].encode(image)
        while budget_bytes is not None and low < high:
            middle = (low + high + 1) // 2
            tried = self._codecs[middle].encode(image)
            if len(tried) <= budget_bytes:
                low, best = middle, tried
            else:
                high = middle - 1
        self.bitstreams[frame] = best
        return len(best)


Encode = Callable[[int, float | None], int]
"""The size of a frame that is to fit a budget in bytes; None where nothing is known of the link yet."""


def _values(adaptation: Adaptation) -> list[int | float]:
    first, last = adaptation.range
    if isinstance(first, int) and isinstance(last, int):
        return list(range(first, last + 1)) if first <= last else list(range(first, last - 1, -1))
    return [first + (last - first) * step / (_STEPS - 1) for step in range(_STEPS)]


def _variant(codec: Codec, parameter: str, value: float) -> Codec:  # type: ignore[type-arg]
    values = codec.params.model_dump()
    if parameter not in values:
        raise Unsupported(f"adapt: {codec.name} has no parameter {parameter!r}; it has {', '.join(values) or 'none'}")
    try:
        return type(codec)(codec.params_type.model_validate({**values, parameter: value}))
    except ValidationError as error:
        raise Unsupported(
            f"adapt: {codec.name} does not take {parameter}={value}: {error.errors()[0]['msg']}"
        ) from error
