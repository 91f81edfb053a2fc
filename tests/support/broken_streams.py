"""A small codec with memory that keeps the contract, and others that each break it in one way.

A packet is the difference from the picture before, deflated, behind 5 bytes: whether it starts, height and width, then
a checksum; every fourth packet starts.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from codecbench import (
    LOST,
    NULL_TRACE,
    BitstreamError,
    Capabilities,
    Image,
    ImageError,
    Loss,
    NoParams,
    Packet,
    Picture,
    StreamCodec,
    StreamDecoder,
    StreamEncoder,
    Trace,
    check_image,
)
from codecbench.core.contracts.image import MAX_PIXELS

_HEADER = struct.Struct("<BBHH")
_GOP = 4


class DeltaEncoder(StreamEncoder):
    def __init__(self) -> None:
        self.before: Image | None = None
        self.pushed = 0

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        image = check_image(image)
        if self.before is not None and self.before.shape != image.shape:
            raise ImageError(f"shape {image.shape} in a stream of shape {self.before.shape}")
        starts = self.starts()
        reference = np.zeros_like(image) if starts or self.before is None else self.before
        header = _HEADER.pack(starts, 1 if image.ndim == 2 else 3, *image.shape[:2])
        packet = Packet(_sealed(header, (image - reference).tobytes()), self.pushed, starts)
        self.before = image.copy()
        self.pushed += 1
        return [packet]

    def starts(self) -> bool:
        return self.pushed % _GOP == 0

    def flush(self) -> list[Packet]:
        return []


class DeltaDecoder(StreamDecoder):
    def __init__(self) -> None:
        self.before: Image | None = None
        self.next = 0

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        if packet is LOST:
            self.before = None
            self.next += 1
            return [Picture(self.next - 1, "missing", None)]
        assert isinstance(packet, Packet)
        self.next = packet.frame + 1
        before, self.before = self.before, None
        starts, difference = _opened(packet.data)
        if not starts and (before is None or before.shape != difference.shape):
            return [Picture(packet.frame, "missing", None)]
        self.before = difference if starts else difference + before
        return [Picture(packet.frame, "whole", self.before.copy())]

    def flush(self) -> list[Picture]:
        return []


def _sealed(header: bytes, samples: bytes) -> bytes:
    content = header + zlib.compress(samples)
    return content + zlib.crc32(content).to_bytes(4, "little")


def _opened(data: bytes) -> tuple[bool, Image]:
    content = data[:-4]
    if len(content) < _HEADER.size or zlib.crc32(content).to_bytes(4, "little") != data[-4:]:
        raise BitstreamError("delta: damaged or foreign")
    starts, channels, height, width = _HEADER.unpack_from(content)
    size = height * width * channels
    if channels not in (1, 3) or not 0 < size <= 3 * MAX_PIXELS:
        raise BitstreamError("delta: a header that no encoder writes")
    samples = zlib.decompress(content[_HEADER.size :])
    if len(samples) != size:
        raise BitstreamError("delta: the samples are not those of the header")
    shape = (height, width) if channels == 1 else (height, width, 3)
    return bool(starts), np.frombuffer(samples, np.uint8).reshape(shape).copy()


class Delta(StreamCodec[NoParams]):
    """Keeps the contract."""

    name = "delta"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities(lossless=True)
    Encoding: ClassVar[type[DeltaEncoder]] = DeltaEncoder
    Decoding: ClassVar[type[DeltaDecoder]] = DeltaDecoder

    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return self.Encoding()

    def decoder(self) -> StreamDecoder:
        return self.Decoding()


class PeeksAtTheFuture(Delta):
    """Writes a byte of the picture that lies behind this one in memory into the packet."""

    class Encoding(DeltaEncoder):
        ahead = 0

        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            (packet,) = super().push(image)
            film, seen = image.base if isinstance(image, np.ndarray) else None, self.pushed + self.ahead
            if not isinstance(film, np.ndarray) or film.ndim != image.ndim + 1 or seen >= len(film):
                return [packet]
            hint = film[seen].tobytes()[:8]
            return [Packet(packet.data[:-4] + hint + packet.data[-4:], packet.frame, packet.starts)]


class PeeksWhileItHoldsBack(PeeksAtTheFuture):
    """The same thirty pictures ahead, in packets of which twenty are held back: a short stream sees none leave."""

    class Encoding(PeeksAtTheFuture.Encoding):
        ahead = 30

        def __init__(self) -> None:
            super().__init__()
            self.held: list[Packet] = []

        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            self.held += super().push(image)
            return [self.held.pop(0)] if len(self.held) > 20 else []

        def flush(self) -> list[Packet]:
            return self.held


class ChangesWhatItSent(Delta):
    """Completes the packet before when the next picture is there."""

    class Encoding(DeltaEncoder):
        sent: Packet | None = None

        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            packets = super().push(image)
            if self.sent is not None:
                object.__setattr__(self.sent, "data", self.sent.data + b"more")
            self.sent = packets[0]
            return packets


class ForgetsAtFlush(Delta):
    """Holds a picture back and does not give it at the end."""

    class Encoding(DeltaEncoder):
        held: list[Packet] = []

        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            ready, self.held = self.held, super().push(image)
            return ready

    def is_low_delay(self) -> bool:
        return False


class ForgetsWhatItHeldLong(Delta):
    """Looks 25 pictures ahead, and gives 20 of them at the end: no shorter stream misses any."""

    class Encoding(DeltaEncoder):
        def __init__(self) -> None:
            super().__init__()
            self.held: list[Packet] = []

        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            self.held += super().push(image)
            return [self.held.pop(0)] if len(self.held) > 25 else []

        def flush(self) -> list[Packet]:
            return self.held[:20]

    def is_low_delay(self) -> bool:
        return False


class HidesStateInAGlobal(Delta):
    """The picture before is one for all sessions."""

    class Encoding(DeltaEncoder):
        last: ClassVar[dict[tuple[int, ...], Image]] = {}

        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            shown = check_image(image)
            if self.pushed:
                self.before = HidesStateInAGlobal.Encoding.last[shown.shape[2:]]
                self.before = np.resize(self.before, shown.shape) if self.before.shape != shown.shape else self.before
            packets = super().push(image)
            HidesStateInAGlobal.Encoding.last[shown.shape[2:]] = shown.copy()
            return packets


class StartsWhereNoneIs(Delta):
    """Claims of every packet that decoding can start there."""

    class Encoding(DeltaEncoder):
        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            return [Packet(packet.data, packet.frame, starts=True) for packet in super().push(image)]


class PromisesRecovery(Delta):
    """Says of a packet that pictures are whole two frames later, which are not before the next start."""

    class Encoding(DeltaEncoder):
        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            (packet,) = super().push(image)
            return [replace(packet, recovery_frames=1 if packet.frame % _GOP == 1 else None)]


class CountsRecoveryInFractions(Delta):
    """Says when pictures are whole again in what is no number of frames."""

    class Encoding(DeltaEncoder):
        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            return [replace(packet, recovery_frames=2.5) for packet in super().push(image)]  # type: ignore[arg-type]


class CallsWholeWhatIsNot(Delta):
    """Goes on after a loss as if nothing had been."""

    class Decoding(DeltaDecoder):
        def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
            before = self.before
            pictures = super().push(packet)
            self.before = before if packet is LOST else self.before
            return pictures


class JoinsUnsaid(Delta):
    """Begins anywhere, with gray for what it does not have, as if that were a start."""

    class Decoding(DeltaDecoder):
        def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
            if isinstance(packet, Packet) and self.before is None and self.next == 0 and packet.frame > 0:
                self.before = np.full_like(_opened(packet.data)[1], 128)
            return super().push(packet)


class ForgivesTheSecondLoss(Delta):
    """Comes back to the picture before a gap where that is of two packets."""

    class Decoding(DeltaDecoder):
        kept: Image | None = None

        def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
            before = self.before
            pictures = super().push(packet)
            if packet is LOST:
                self.before = self.kept
                self.kept = before
            else:
                self.kept = None
            return pictures


class DoublesAFrame(Delta):
    """Shows the third picture once more when the stream ends."""

    class Decoding(DeltaDecoder):
        third: Picture | None = None

        def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
            pictures = super().push(packet)
            self.third = pictures[0] if pictures[0].frame == 2 else self.third
            return pictures

        def flush(self) -> list[Picture]:
            return [] if self.third is None else [self.third]


class DoublesALateFrame(Delta):
    """Shows picture 30 twice, which a short stream does not have."""

    class Decoding(DeltaDecoder):
        def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
            pictures = super().push(packet)
            return pictures * 2 if pictures[0].frame == 30 else pictures


class LiesAboutItsSize(Delta):
    """Sends four bytes a picture and leaves the rest where only this process finds it."""

    store: ClassVar[dict[bytes, bytes]] = {}

    class Encoding(DeltaEncoder):
        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            (packet,) = super().push(image)
            LiesAboutItsSize.store[packet.data[-4:]] = packet.data
            return [Packet(packet.data[-4:], packet.frame, packet.starts)]

    class Decoding(DeltaDecoder):
        def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
            if not isinstance(packet, Packet):
                return super().push(packet)
            if packet.data not in LiesAboutItsSize.store:
                raise BitstreamError("never seen")
            return super().push(Packet(LiesAboutItsSize.store[packet.data], packet.frame, packet.starts))


class SendsAnAttachment(Delta):
    """Its packets carry more than what is counted."""

    class Attached(Packet):
        pass

    class Encoding(DeltaEncoder):
        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            (packet,) = super().push(image)
            attached = SendsAnAttachment.Attached(packet.data, packet.frame, packet.starts)
            object.__setattr__(attached, "extra", np.array(image))
            return [attached]


class AnswersLate(Delta):
    """Claims low delay and gives each packet one picture later."""

    class Encoding(DeltaEncoder):
        def __init__(self) -> None:
            super().__init__()
            self.held: list[Packet] = []

        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            ready, self.held = self.held, super().push(image)
            return ready

        def flush(self) -> list[Packet]:
            return self.held


class AnswersLateLater(AnswersLate):
    """The same, but from picture 30 on."""

    class Encoding(AnswersLate.Encoding):
        def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
            ready = super().push(image)
            if self.pushed <= 30:
                ready, self.held = ready + self.held, []
            return ready


BROKEN: dict[type[Any], str] = {
    PeeksAtTheFuture: "future",
    PeeksWhileItHoldsBack: "future",
    ChangesWhatItSent: "future",
    ForgetsAtFlush: "flush",
    ForgetsWhatItHeldLong: "flush",
    HidesStateInAGlobal: "interleaved",
    PromisesRecovery: "loss",
    CountsRecoveryInFractions: "bytes",
    StartsWhereNoneIs: "starts",
    CallsWholeWhatIsNot: "loss",
    JoinsUnsaid: "loss",
    ForgivesTheSecondLoss: "loss",
    DoublesAFrame: "flush",
    DoublesALateFrame: "flush",
    LiesAboutItsSize: "self_contained",
    SendsAnAttachment: "bytes",
    AnswersLate: "one_in_one_out",
    AnswersLateLater: "one_in_one_out",
}
"""Each with the check that is meant to catch it."""
