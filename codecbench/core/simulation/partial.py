"""Pictures of which packets are missing: what is there of them, when that is known, and what a decoder makes of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from codecbench.core.contracts.codec import Fragment, PartialImage
from codecbench.core.contracts.errors import BitstreamError, PluginError
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.simulation.sender import Shipment
from codecbench.core.simulation.settings import LinkSettings

Ranges = tuple[tuple[int, int], ...]
"""First byte and end of each part of a bitstream that came, in order, with gaps between them."""


@dataclass(frozen=True)
class ReceivedRanges:
    """What came of a unit that never is whole. known_s: when all of that is there and the rest is known to be lost."""

    known_s: float
    ranges: Ranges

    @property
    def size_bytes(self) -> int:
        """Of all that came."""
        return sum(end - begin for begin, end in self.ranges)


@dataclass(frozen=True)
class Part:
    """A picture that came in part. whole_share: of its pixels, those that are as the whole bitstream gives them."""

    received: ReceivedRanges
    whole_share: float


PartialDecode = Callable[[int, Ranges], float | None]
"""The share of a frame's pixels that are whole in what a decoder makes of parts of it; None where it makes nothing."""


def received_ranges(
    shipments: Mapping[int, Shipment], sizes_bytes: Mapping[int, int], settings: LinkSettings
) -> dict[int, ReceivedRanges]:
    """By unit, what came of those that are not whole; of transports that send nothing again.

    shipments: in the order in which they were sent. A missing packet is known to be lost when one has arrived that was
    sent after it; what comes after that all the same, because packets overtake each other, is waited for. So a picture
    that comes whole is never taken for one that does not.
    """
    by_unit: dict[int, ReceivedRanges] = {}
    payload, next_s = settings.payload_bytes, math.inf
    for unit in reversed(list(shipments)):
        shipment = shipments[unit]
        came: dict[int, float] = {number: arrives_s for arrives_s, number in shipment.arrivals}
        if math.isinf(shipment.complete_s) and came:
            last = max(set(range(shipment.count)) - set(came))
            told_s = min([next_s, *(arrives_s for number, arrives_s in came.items() if number > last)])
            numbers = sorted(number for number in came if number < shipment.needed)
            if numbers and told_s < math.inf:
                by_unit[unit] = ReceivedRanges(
                    max(told_s, *came.values()), _ranges(numbers, payload, sizes_bytes[unit])
                )
        next_s = min([next_s, *came.values()])
    return by_unit


def _ranges(numbers: list[int], payload: int, size_bytes: int) -> Ranges:
    ranges: list[tuple[int, int]] = []
    for number in numbers:
        begin, end = number * payload, min((number + 1) * payload, size_bytes)
        if ranges and ranges[-1][1] == begin:
            begin = ranges.pop()[0]
        ranges.append((begin, end))
    return tuple(ranges)


class PartialDecoder:
    """Decodes frames of a coded sequence as far as they came.

    bitstreams: of the frames that were coded anew.
    """

    def __init__(self, coded: CodedSequence, bitstreams: Mapping[int, bytes]) -> None:
        self._coded, self._bitstreams = coded, bitstreams
        codec = coded.codec
        self._codec = codec if codec.capabilities.partial_decoding else None

    def decode(self, frame: int, ranges: Ranges) -> PartialImage | None:
        """None where the codec makes nothing of it. Raises PluginError for what is no picture with a mask of it."""
        if self._codec is None:
            return None
        bitstream = self._bitstreams.get(frame) or self._coded.frame(frame).bitstream
        try:
            partial = self._codec.decode_partial([Fragment(begin, bitstream[begin:end]) for begin, end in ranges])
        except BitstreamError:
            return None
        if partial.whole.shape != partial.image.shape[:2] or partial.whole.dtype != bool:
            shapes = f"an image of shape {partial.image.shape}, whole {partial.whole.dtype} of {partial.whole.shape}"
            raise PluginError(f"{self._codec.name}.decode_partial: {shapes}; whole is bool, (H, W)")
        return partial

    def whole_share(self, frame: int, ranges: Ranges) -> float | None:
        """See `PartialDecode`."""
        partial = self.decode(frame, ranges)
        return None if partial is None else float(partial.whole.mean())
