"""The `stream` evaluator measures bit rate, coding delay, and random access in the middle of a stream."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.codec import AnyCodec, decoder_of
from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.evaluator import CodedSequence, Context, Measurement, SentPacket, SequenceEvaluator
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Packet, Picture
from codecbench.plugins.evaluators.fidelity import psnr_db


class StreamParams(Params):
    """Set how random access is measured.

    joins: how often a decoder joins the stream in the middle; 0 omits the metrics of random access.
    whole_db: least PSNR, in dB, of a whole frame against the uninterrupted decoding.
    """

    joins: Annotated[int, Field(ge=0, le=1000)] = 5
    whole_db: Annotated[float, Field(ge=20.0)] = 50.0


class Stream(SequenceEvaluator[StreamParams]):
    """Bit rate, delay and random access, also of codecs without memory."""

    name = "stream"
    version = "1"
    bits = (8, 16)
    params_type = StreamParams
    typical_ms_per_frame = 15.0
    metrics: ClassVar[tuple[Metric, ...]] = (
        Metric(
            "bitrate_kbps", "kbit/s", "lower", "the frame's bits times the nominal frame rate",
            role="rate", headline=True, label="bit rate", column_header="kbit/s", scale="log",
        ),
        Metric("mean_frame_bytes", "bytes", "lower", "mean frame size", role="rate", scale="log"),
        Metric("largest_frame_bytes", "bytes", "lower", "largest frame size", role="rate", scale="log"),
        Metric(
            "peak_kbps", "kbit/s", "lower",
            "greatest rate over 1 s, in sending order",
            role="rate", label="peak rate", scale="log",
        ),
        Metric(
            "intra_to_predicted", "1", "neither", "mean size of keyframes over that of others",
            label="intra to predicted", scale="log",
        ),
        Metric(
            "delay_frames", "frames", "lower",
            "most later frames that enter the encoder before a frame's packet leaves it",
            label="frames held back",
        ),
        Metric(
            "delay_ms", "ms", "lower", "delay_frames at the frame rate",
            role="time", headline=True, label="coding delay", column_header="delay ms",
        ),
        Metric(
            "first_packet_frames", "frames", "lower",
            "later frames that enter the encoder before the first packet leaves it",
            label="frames before the first packet",
        ),
        Metric(
            "first_packet_ms", "ms", "lower", "first_packet_frames at the frame rate",
            label="wait for the first packet",
        ),
        Metric(
            "joining_frames", "frames", "lower",
            "median frames from joining until all later ones are whole",
            headline=True, label="random access delay", column_header="join",
        ),
        Metric(
            "joining_worst_frames", "frames", "lower", "joining_frames of the worst join",
            label="random access delay, worst",
        ),
    )  # fmt: skip

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        packets, rate_hz = coded.packets, coded.sequence.frame_rate_hz
        for packet in sorted(packets, key=lambda packet: packet.frame):
            yield Measurement("bitrate_kbps", 8e-3 * packet.size_bytes * rate_hz, frame=packet.frame)
        sizes = np.array([packet.size_bytes for packet in packets], np.float64)
        yield Measurement("mean_frame_bytes", float(sizes.mean()))
        yield Measurement("largest_frame_bytes", float(sizes.max()))
        yield _peak(sizes, rate_hz)
        yield _intra_to_predicted(packets)
        yield from _wait_measurements("delay", max(packet.after - packet.frame - 1 for packet in packets), rate_hz)
        yield from _wait_measurements("first_packet", packets[0].after - 1, rate_hz)
        if self.params.joins:
            yield from self._joining(coded)

    def _joining(self, coded: CodedSequence) -> Iterator[Measurement]:
        places = join_places(len(coded.packets), self.params.joins)
        if not places:
            yield from (_missing(name, "a sequence of one frame cannot be joined in the middle") for name in _JOINING)
            return
        waits = frames_until_whole(coded, places, self.params.whole_db)
        never = f"the last frame was not whole after {sum(map(math.isinf, waits))} of {len(places)} joins"
        for name, frames in zip(_JOINING, (float(np.median(waits)), max(waits)), strict=True):
            yield _missing(name, never) if math.isinf(frames) else Measurement(name, frames)


_JOINING = ("joining_frames", "joining_worst_frames")
"""The metrics of random access: the median and the worst of all joins."""


def _missing(metric: str, reason: str) -> Measurement:
    return Measurement(metric, math.nan, reason=reason)


def _wait_measurements(name: str, frames: int, rate_hz: float) -> Iterator[Measurement]:
    yield Measurement(f"{name}_frames", float(frames))
    yield Measurement(f"{name}_ms", 1e3 * frames / rate_hz)


def _peak(sizes: NDArray[np.float64], rate_hz: float) -> Measurement:
    """The highest rate over 1 s, with packets sent one after the other at the sequence's frame rate."""
    window = math.ceil(rate_hz - 1e-9)
    if len(sizes) < window:
        return _missing("peak_kbps", f"the sequence lasts {len(sizes) / rate_hz:.2g} s")
    sums = np.convolve(sizes, np.ones(window), "valid")
    return Measurement("peak_kbps", 8e-3 * float(sums.max()))


def _intra_to_predicted(packets: tuple[SentPacket, ...]) -> Measurement:
    intra = [packet.size_bytes for packet in packets if packet.starts]
    predicted = [packet.size_bytes for packet in packets if not packet.starts]
    if not predicted:
        return _missing("intra_to_predicted", "decoding can start at every frame")
    return Measurement("intra_to_predicted", float(np.mean(intra) / np.mean(predicted)))


def join_places(packets: int, joins: int) -> list[int]:
    """Up to `joins` random positions in the first half of the packets, one in each of equal parts, never the first.

    They are random so that they do not align with periodic keyframes, and equal for all settings of a sequence. After
    each of them at least half of the sequence is left for pictures to become whole.
    """
    last = packets // 2
    bounds = np.linspace(1, last + 1, min(joins, last) + 1).round().astype(int)
    rng = np.random.default_rng(0)
    return [int(rng.integers(low, high)) for low, high in pairwise(bounds)]


def frames_until_whole(coded: CodedSequence, places: list[int], whole_db: float) -> list[float]:
    """For each place in sending order, the frames from that packet's frame to the first from which on all are whole.

    A picture is whole if its PSNR against the uninterrupted decoding is `whole_db` or more. The value is infinite if
    the last picture is not whole. Codecs without memory, and feature codecs, are whole from the next keyframe on.
    """
    if coded.codec.stateless or coded.codec.carries == "features":
        return [_frames_until_keyframe(coded.packets[place:]) for place in places]
    joiners = {place: _Joiner(coded.codec, coded.packets[place].frame) for place in places}
    for at, sent in enumerate(coded.packets):
        watching = [joiner for place, joiner in joiners.items() if place <= at]
        if watching:
            packet = sent.packet(coded.frame(sent.frame).bitstream)
            for joiner in watching:
                joiner.record(joiner.pictures(packet), coded, whole_db)
    for joiner in joiners.values():
        joiner.record(joiner.pictures(None), coded, whole_db)
    return [joiners[place].frames_until_whole(len(coded)) for place in places]


def _frames_until_keyframe(packets: Sequence[SentPacket]) -> float:
    """The number of frames from the first packet to the next keyframe."""
    return next((float(packet.frame - packets[0].frame) for packet in packets if packet.starts), math.inf)


class _Joiner:
    """A receiver that decodes a stream from the packet of frame `joined` on, and nothing before it."""

    def __init__(self, codec: AnyCodec[Any], joined: int) -> None:
        self._decoder = decoder_of(codec)
        self._joined = joined
        self._whole: set[int] = set()

    def pictures(self, packet: Packet | None) -> list[Picture]:
        """Pictures decoded from a packet, or at the end of the stream; none if the decoder cannot begin with it."""
        try:
            return self._decoder.flush() if packet is None else self._decoder.push(packet)
        except BitstreamError:
            return []

    def record(self, pictures: list[Picture], coded: CodedSequence, whole_db: float) -> None:
        """Note which of the pictures are whole."""
        for picture in pictures:
            counts = picture.frame >= self._joined and picture.image is not None
            if counts and _is_whole(picture.image, coded.frame(picture.frame).decoded, whole_db):
                self._whole.add(picture.frame)

    def frames_until_whole(self, frames: int) -> float:
        """The number of frames from the joined one to the first whole one; infinite if the last frame is not whole."""
        first = frames
        while first > self._joined and first - 1 in self._whole:
            first -= 1
        return math.inf if first == frames else float(first - self._joined)


def _is_whole(image: Image | None, uninterrupted: Image, whole_db: float) -> bool:
    if image is None or image.shape != uninterrupted.shape:
        return False
    if np.array_equal(image, uninterrupted):
        return True
    return image.dtype == np.uint8 and psnr_db(uninterrupted, image) >= whole_db  # 16 bits may be depth: no PSNR fits
