"""Pictures and streams that are coded as coarsely as the link asks."""

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
"""So far back the sender looks at what the link gave."""
FILL: Final = 0.9
"""Share of that which a picture may take: the rest is for headers, and for what the next second may not give."""
_STEPS: Final = 64
"""Values of a range whose ends are not whole numbers."""
SESSION_S: Final = 1.0
"""So long at least a stream keeps its setting: another one takes a new session, which begins with a start."""
_ROUNDING_S: Final = 1e-6

C = TypeVar("C", bound=AnyCodec[Any])


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


class AdaptiveEncoder(Protocol):
    """Codes frames as they are chosen, in rising order, as finely as fits.

    bitstreams: of the frames that were coded.
    """

    bitstreams: dict[int, bytes]

    def encode(self, frame: int, budget_bytes: float | None, waiting_bytes: int) -> SentPacket:
        """What becomes of a frame.

        budget_bytes: of a picture, at what the link gives; None where nothing is known of it yet. waiting_bytes: of all
        that was coded before and has not left yet.
        """
        ...


def adaptive_encoder(coded: CodedSequence, adaptation: Adaptation) -> AdaptiveEncoder:
    """For the codec of a coded sequence, of which only the pictures are taken.

    Raises Unsupported for a codec that holds pictures back, and for a parameter or a range that it does not take.
    """
    codec = coded.codec
    if codec.carries != "pictures":
        raise Unsupported(f"adapt: {codec.name} codes neither single pictures nor a stream of them")
    return AdaptivePictures(coded, adaptation) if codec.stateless else AdaptiveStream(coded, adaptation)


class AdaptivePictures:
    """Codes each picture as finely as fits, between the ends of a range."""

    def __init__(self, coded: CodedSequence, adaptation: Adaptation) -> None:
        self._sequence = coded.sequence
        self._codecs = _variants(coded.codec, adaptation)
        self.bitstreams: dict[int, bytes] = {}

    def encode(self, frame: int, budget_bytes: float | None, waiting_bytes: int) -> SentPacket:
        """Of the finest that fits the budget, else of the coarsest."""
        image = self._sequence.read(frame).image
        tried: dict[int, bytes] = {}

        def size_bytes(level: int) -> int:
            tried[level] = self._codecs[level].encode(image)
            return len(tried[level])

        level = _finest_within(budget_bytes, len(self._codecs), size_bytes)
        if level not in tried:
            size_bytes(level)
        self.bitstreams[frame] = tried[level]
        return SentPacket(frame, len(tried[level]), True, frame + 1)


class AdaptiveStream:
    """Codes a stream in sessions, each at one setting, and begins another when another setting fits.

    That is the finest at which the pictures of the last second would have fitted into what the link gives, beside what
    waits: coded as a session of their own, with the start that it costs. It is looked for once a second.
    """

    def __init__(self, coded: CodedSequence, adaptation: Adaptation) -> None:
        codec = coded.codec
        if not codec.is_low_delay():
            raise Unsupported(f"adapt: {codec.name} holds pictures back with this setting; give one that does not")
        self._sequence = coded.sequence
        self._codecs = _variants(codec, adaptation)
        self._level = 0
        self._encoder: StreamEncoder | None = None
        self._session, self._pushed, self._decided_s = -1, 0, 0.0
        self._recent: deque[tuple[float, Image]] = deque()
        self.bitstreams: dict[int, bytes] = {}

    def encode(self, frame: int, budget_bytes: float | None, waiting_bytes: int) -> SentPacket:
        """The first session is at the coarsest setting."""
        image, now_s = self._sequence.read(frame).image, float(self._sequence.timestamps_s[frame])
        while self._recent and self._recent[0][0] <= now_s - WINDOW_S + _ROUNDING_S:
            self._recent.popleft()
        level = self._level
        if self._encoder is None:
            self._decided_s = now_s
        elif budget_bytes is not None and now_s - self._decided_s >= SESSION_S - _ROUNDING_S:
            self._decided_s = now_s
            pictures = [picture for _, picture in self._recent]
            room_bytes = budget_bytes * len(pictures) - waiting_bytes
            level = _finest_within(room_bytes, len(self._codecs), lambda level: self._size_bytes(level, pictures))
        if self._encoder is None or level != self._level:
            self._encoder = self._codecs[level].open_encoder(self._sequence.frame_rate_hz)
            self._level, self._session, self._pushed = level, self._session + 1, 0
        self._recent.append((now_s, image))
        packets = self._encoder.push(image)
        if len(packets) != 1 or packets[0].frame != self._pushed:
            told = f"gave {len(packets)} packets for picture {self._pushed} of a session"
            raise PluginError(f"{self._codecs[level].name} says that it is of low delay, and {told}; it gives its own")
        (packet,) = packets
        self._pushed += 1
        self.bitstreams[frame] = packet.data
        return SentPacket(frame, len(packet.data), packet.starts, frame + 1, packet.recovery_frames, self._session)

    def _size_bytes(self, level: int, pictures: Iterable[Image]) -> int:
        """Of these as a session of their own."""
        encoder = self._codecs[level].open_encoder(self._sequence.frame_rate_hz)
        return sum(len(packet.data) for picture in pictures for packet in encoder.push(picture))


def _finest_within(budget_bytes: float | None, levels: int, size_bytes: Callable[[int], int]) -> int:
    """The finest of levels from 0 on that fits, else 0; by bisection, as if finer were never smaller."""
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
        said = error.errors()[0]["msg"] if isinstance(error, ValidationError) else str(error)
        raise Unsupported(f"adapt: {codec.name} does not take {parameter}={value}: {said}") from error
