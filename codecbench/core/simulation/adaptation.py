"""Rate adaptation: the sender encodes frames as coarsely as the link's throughput requires."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, Protocol, TypeVar

from pydantic import ValidationError

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.evaluator import CodedSequence, SentPacket
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.stream import StreamEncoder
from codecbench.core.simulation.settings import Adaptation

WINDOW_S: Final = 1.0
"""Window in seconds over which the sender measures throughput."""
FILL: Final = 0.9
"""Share of the throughput that frames may use; the rest covers headers and a drop within the next second."""
_STEPS: Final = 64
"""Number of values in a range whose ends are not integers."""
SESSION_S: Final = 1.0
"""Least time in seconds between changes of a stream's setting: each opens a session, which begins with a keyframe."""
_ROUNDING_S: Final = 1e-6

C = TypeVar("C", bound=AnyCodec[Any])


class Throughput:
    """Throughput of a link: bytes over the time that it spent sending."""

    def __init__(self) -> None:
        self._packets: deque[tuple[float, int, float]] = deque()
        self._last_s = 0.0
        self._rate: float | None = None

    def add(self, size_bytes: int, turn_s: float, sent_s: float) -> None:
        """Record a packet that left at `sent_s`; it started at `turn_s`, or once the last one had left if later."""
        self._packets.append((sent_s, size_bytes, sent_s - max(turn_s, self._last_s)))
        self._last_s = sent_s

    def bytes_per_s(self, now_s: float) -> float | None:
        """Return the rate of the last second, or the last known one if nothing left since; None before any packet."""
        while self._packets and self._packets[0][0] <= now_s - WINDOW_S:
            self._packets.popleft()
        recent = [(size_bytes, busy_s) for sent_s, size_bytes, busy_s in self._packets if sent_s <= now_s]
        if recent:
            busy_s = sum(busy_s for _, busy_s in recent)
            self._rate = sum(size_bytes for size_bytes, _ in recent) / busy_s if busy_s > 0.0 else math.inf
        return self._rate


class AdaptiveEncoder(Protocol):
    """Encodes chosen frames, in rising order, as finely as fits."""

    bitstreams: dict[int, bytes]
    """By frame, those that were encoded."""

    def encode(self, frame: int, budget_bytes: float | None, waiting_bytes: int) -> SentPacket:
        """Encode a frame.

        budget_bytes: for one frame at the link's throughput; None if that is unknown yet. waiting_bytes: of all that is
        coded and not sent yet.
        """
        ...


def adaptive_encoder(coded: CodedSequence, adaptation: Adaptation) -> AdaptiveEncoder:
    """Create the adaptive encoder for the codec of a coded sequence, of which only the original frames are used.

    Raises Unsupported if the codec holds frames back, or does not accept the parameter or its range.
    """
    codec = coded.codec
    if codec.carries != "pictures":
        raise Unsupported(f"adapt: {codec.name} encodes neither single frames nor a stream of frames")
    return AdaptivePictures(coded, adaptation) if codec.stateless else AdaptiveStream(coded, adaptation)


class AdaptivePictures:
    """Encodes each frame on its own as finely as fits, within a range."""

    def __init__(self, coded: CodedSequence, adaptation: Adaptation) -> None:
        self._sequence = coded.sequence
        self._codecs = _variants(coded.codec, adaptation)
        self.bitstreams: dict[int, bytes] = {}

    def encode(self, frame: int, budget_bytes: float | None, waiting_bytes: int) -> SentPacket:
        """Encode at the finest level that fits the budget, else at the coarsest."""
        image = self._sequence.read(frame).image
        by_level: dict[int, bytes] = {}

        def size_bytes(level: int) -> int:
            by_level[level] = self._codecs[level].encode(image)
            return len(by_level[level])

        level = _finest_within(budget_bytes, len(self._codecs), size_bytes)
        if level not in by_level:
            size_bytes(level)
        self.bitstreams[frame] = by_level[level]
        return SentPacket(frame, len(by_level[level]), True, frame + 1)


class AdaptiveStream:
    """Encodes a stream in sessions, each at one setting, and opens another when another setting fits.

    Once a second it looks for the finest setting at which the last second's frames would have fitted the link beside
    what waits. They are encoded as a session of their own, so the cost of its keyframe counts.
    """

    def __init__(self, coded: CodedSequence, adaptation: Adaptation) -> None:
        codec = coded.codec
        if not codec.is_low_delay():
            raise Unsupported(f"adapt: {codec.name} delays frames with this setting; give a low-delay setting")
        self._sequence = coded.sequence
        self._codecs = _variants(codec, adaptation)
        self._level = 0
        self._encoder: StreamEncoder | None = None
        self._session, self._pushed, self._decided_s = -1, 0, 0.0
        self._recent: deque[tuple[float, Image]] = deque()
        self.bitstreams: dict[int, bytes] = {}

    def encode(self, frame: int, budget_bytes: float | None, waiting_bytes: int) -> SentPacket:
        """Encode a frame; the first session is at the coarsest setting."""
        image, now_s = self._sequence.read(frame).image, float(self._sequence.timestamps_s[frame])
        while self._recent and self._recent[0][0] <= now_s - WINDOW_S + _ROUNDING_S:
            self._recent.popleft()
        level = self._level
        if self._encoder is None:
            self._decided_s = now_s
        elif budget_bytes is not None and now_s - self._decided_s >= SESSION_S - _ROUNDING_S:
            self._decided_s = now_s
            images = [recent_image for _, recent_image in self._recent]
            free_bytes = budget_bytes * len(images) - waiting_bytes
            level = _finest_within(free_bytes, len(self._codecs), lambda level: self._size_bytes(level, images))
        if self._encoder is None or level != self._level:
            self._encoder = self._codecs[level].open_encoder(self._sequence.frame_rate_hz)
            self._level, self._session, self._pushed = level, self._session + 1, 0
        self._recent.append((now_s, image))
        packets = self._encoder.push(image)
        if len(packets) != 1 or packets[0].frame != self._pushed:
            fault = f"returned {len(packets)} packets for frame {self._pushed} of a session"
            raise PluginError(
                f"{self._codecs[level].name} is declared low-delay but {fault}; expected one, of that frame"
            )
        (packet,) = packets
        self._pushed += 1
        self.bitstreams[frame] = packet.data
        return SentPacket(frame, len(packet.data), packet.starts, frame + 1, packet.recovery_frames, self._session)

    def _size_bytes(self, level: int, images: Iterable[Image]) -> int:
        """Return the size of these frames, encoded as a session of their own."""
        encoder = self._codecs[level].open_encoder(self._sequence.frame_rate_hz)
        return sum(len(packet.data) for image in images for packet in encoder.push(image))


def _finest_within(budget_bytes: float | None, levels: int, size_bytes: Callable[[int], int]) -> int:
    """Return the finest level that fits, else 0; by bisection, assuming that sizes do not decrease with the level."""
    low, high = 0, levels - 1
    while budget_bytes is not None and low < high:
        middle = (low + high + 1) // 2
        if size_bytes(middle) <= budget_bytes:
            low = middle
        else:
            high = middle - 1
    return low


def _variants(codec: C, adaptation: Adaptation) -> Sequence[C]:
    return [_variant(codec, adaptation.parameter, value) for value in _values(adaptation)]


def _values(adaptation: Adaptation) -> list[int | float]:
    first, last = adaptation.range
    if isinstance(first, int) and isinstance(last, int):
        return list(range(first, last + 1)) if first <= last else list(range(first, last - 1, -1))
    return [first + (last - first) * step / (_STEPS - 1) for step in range(_STEPS)]


def _variant(codec: C, parameter: str, value: float) -> C:
    values = codec.params.model_dump()
    if parameter not in values:
        raise Unsupported(f"adapt: {codec.name} has no parameter {parameter!r}; it has {', '.join(values) or 'none'}")
    try:
        return codec.with_params(**{parameter: value})
    except (ValidationError, PluginError) as error:
        reason = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise Unsupported(f"adapt: {codec.name} rejects {parameter}={value}: {reason}") from error
