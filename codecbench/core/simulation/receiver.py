"""The receiver: decodes complete frames in order, or what arrived of incomplete ones, and outputs those in time."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.codec import Fragment, PartialImage
from codecbench.core.contracts.errors import BitstreamError, PluginError
from codecbench.core.contracts.evaluator import CodedSequence, SentPacket
from codecbench.core.simulation.sender import Shipment
from codecbench.core.simulation.settings import LinkSettings

FrameOutcome = Literal["on time", "concealed", "partial", "late", "lost", "broken", "skipped"]
"""Delivery outcome of a frame.

`skipped`: not sent. `lost`: some of its packets never arrived. `partial`: the same, output as far as it arrived.
`broken`: complete, but it depends on an incomplete frame. `concealed`: the same, output as the decoder conceals it.
`late`: past the deadline, or after a newer frame."""

Ranges = tuple[tuple[int, int], ...]
"""First byte and end of each part of a bitstream that arrived, in order, with gaps between them."""

PartialDecode = Callable[[int, Ranges], float | None]
"""Returns the share of a frame's pixels that are whole when parts of it are decoded; None if they cannot be."""


@dataclass(frozen=True)
class ReceivedRanges:
    """What arrived of a unit that is never complete."""

    known_s: float
    """Time at which all of it has arrived and the rest is known to be lost."""
    ranges: Ranges

    @property
    def size_bytes(self) -> int:
        """Total size of the ranges."""
        return sum(end - begin for begin, end in self.ranges)


@dataclass(frozen=True)
class Part:
    """A frame that arrived in part."""

    received: ReceivedRanges
    whole_share: float
    """Share of its pixels that equal the complete bitstream's."""


def frame_outcomes(
    units: Mapping[int, SentPacket],
    captured_s: NDArray[np.float64],
    complete_s: Mapping[int, float],
    settings: LinkSettings,
    partial_s: Mapping[int, float] = MappingProxyType({}),
) -> tuple[list[FrameOutcome], NDArray[np.float64]]:
    """Return the delivery outcome of each frame, and (N,) when it was output; infinite if it was not.

    units: by number, in order. captured_s: (N,) capture times. complete_s: by number, when a sent unit was complete;
    infinite if never. partial_s: by number, when an incomplete unit that can be decoded in part is ready. A frame for
    which the encoder returned nothing was skipped.
    """
    if settings.transport == "reliable":
        complete_s = _in_order(complete_s)
    outcomes: list[FrameOutcome] = ["skipped"] * len(captured_s)
    decodable_s = np.full(len(captured_s), math.inf)
    in_time: list[FrameOutcome] = ["on time"] * len(captured_s)
    begun_s, whole_from, session = math.inf, math.inf, 0
    for number, unit in units.items():
        if unit.session != session:  # a session has its own decoder
            begun_s, whole_from, session = math.inf, math.inf, unit.session
        unit_s = complete_s.get(number, math.inf)
        if math.isinf(unit_s):
            whole_from = math.inf
        elif unit.starts:
            begun_s, whole_from = unit_s, -math.inf
        else:
            if unit.recovery_frames is not None:  # the refresh removes all effects of earlier losses
                begun_s = unit_s if math.isinf(begun_s) else begun_s
                whole_from = min(whole_from, unit.frame + unit.recovery_frames)
            begun_s = max(begun_s, unit_s)
        is_broken = unit.frame < whole_from
        if number in partial_s:
            decodable_s[unit.frame], in_time[unit.frame] = partial_s[number], "partial"
            continue
        if math.isinf(unit_s):
            outcomes[unit.frame] = "lost" if number in complete_s else "skipped"
            continue
        outcomes[unit.frame] = "broken" if is_broken else "late"
        if not is_broken or settings.concealed:
            decodable_s[unit.frame] = begun_s
            in_time[unit.frame] = "concealed" if is_broken else "on time"
    decoded_s = _decoding_times(list(units.values()), captured_s, decodable_s, settings)
    output_s = np.full(len(captured_s), math.inf)
    newest = -1
    for frame in sorted(np.flatnonzero(np.isfinite(decoded_s)).tolist(), key=lambda frame: (decoded_s[frame], frame)):
        if frame > newest and decoded_s[frame] - captured_s[frame] <= settings.deadline_s:
            newest, output_s[frame] = frame, decoded_s[frame]
            outcomes[frame] = in_time[frame]
        else:
            outcomes[frame] = "late"
    return outcomes, output_s


def _in_order(complete_s: Mapping[int, float]) -> dict[int, float]:
    """Delay each unit until all earlier ones are complete, as a reliable transport does."""
    numbers = sorted(complete_s)
    return dict(zip(numbers, accumulate((complete_s[number] for number in numbers), max), strict=True))


def _decoding_times(
    units: Sequence[SentPacket],
    captured_s: NDArray[np.float64],
    decodable_s: NDArray[np.float64],
    settings: LinkSettings,
) -> NDArray[np.float64]:
    """Return (N,) when the decoder outputs each frame. It decodes one after another.

    It leaves out intra-coded frames that are past the deadline already. If a stream's frames are sent in another order
    than displayed, each waits for those before it.
    """
    stands_alone = all(unit.starts for unit in units)
    decoded_s, free_s = np.full(len(captured_s), math.inf), 0.0
    for frame in np.lexsort((np.arange(len(decodable_s)), decodable_s)).tolist():
        begun_s = max(free_s, decodable_s[frame])
        if math.isinf(begun_s) or (stands_alone and begun_s - captured_s[frame] > settings.deadline_s):
            continue
        free_s = decoded_s[frame] = begun_s + settings.decode_s
    frames = [unit.frame for unit in units]
    if frames != sorted(frames):
        present = np.flatnonzero(np.isfinite(decoded_s))
        decoded_s[present] = np.maximum.accumulate(decoded_s[present])
    return decoded_s


def received_ranges(
    shipments: Mapping[int, Shipment], sizes_bytes: Mapping[int, int], settings: LinkSettings
) -> dict[int, ReceivedRanges]:
    """Return what arrived of incomplete units, by number; for transports without retransmission.

    shipments: in sending order. A missing packet is known to be lost once a packet sent after it has arrived. Packets
    can overtake each other, so all that arrive later are waited for: a complete frame is never taken for a partial one.
    """
    by_unit: dict[int, ReceivedRanges] = {}
    payload, next_s = settings.payload_bytes, math.inf
    for unit in reversed(list(shipments)):
        shipment = shipments[unit]
        arrived_s: dict[int, float] = {number: time_s for time_s, number in shipment.arrivals}
        if math.isinf(shipment.complete_s) and arrived_s:
            last_lost = max(set(range(shipment.count)) - set(arrived_s))
            loss_known_s = min([next_s, *(time_s for number, time_s in arrived_s.items() if number > last_lost)])
            numbers = sorted(number for number in arrived_s if number < shipment.needed)
            if numbers and loss_known_s < math.inf:
                by_unit[unit] = ReceivedRanges(
                    max(loss_known_s, *arrived_s.values()), _ranges(numbers, payload, sizes_bytes[unit])
                )
        next_s = min([next_s, *arrived_s.values()])
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
    """Decodes frames of a coded sequence as far as they arrived."""

    def __init__(self, coded: CodedSequence, bitstreams: Mapping[int, bytes]) -> None:
        """`bitstreams`: of the frames that were re-encoded."""
        self._coded, self._bitstreams = coded, bitstreams
        codec = coded.codec
        self._codec = codec if codec.capabilities.partial_decoding else None

    def decode(self, frame: int, ranges: Ranges) -> PartialImage | None:
        """Decode parts of a frame; None if the codec cannot. Raises PluginError if the mask does not fit the image."""
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
        """Return the share of whole pixels, as a `PartialDecode`."""
        partial = self.decode(frame, ranges)
        return None if partial is None else float(partial.whole.mean())
