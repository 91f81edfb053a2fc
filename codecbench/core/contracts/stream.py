"""The contract of codecs with memory: an encoder that knows what it sent, a decoder that knows what it got.

One session codes one sequence, in order, and all state is in it. Packets leave in the order in which they are decoded;
pictures are counted from 0 in the order in which they were pushed, which is the order in which they are shown.
A codec of single pictures is the special case in which every packet stands alone: `encoder_of` and `decoder_of` make
sessions of both. `encoder_of` makes one of a codec of features too, which extracts them; its decoders give no pictures.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Final, Literal

from codecbench.core.contracts.codec import AnyCodec, Codec
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.features import FeatureCodec, sends_no_picture
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import P
from codecbench.core.counting.trace import NULL_TRACE, Trace

PictureState = Literal["whole", "concealed", "missing"]
"""`whole`: what the encoder meant. `concealed`: made up in part from others. `missing`: there is no picture."""


class Loss(Enum):
    """The one value that stands for a packet which never came."""

    LOST = "lost"


LOST: Final = Loss.LOST


@dataclass(frozen=True)
class Packet:
    """What is sent of one picture.

    data: every byte that the decoder needs of it, headers included. frame: which picture of the session it is; a link
    carries it as it carries time stamps, so it is not counted. starts: whether decoding can start here, with nothing
    from before. recovery_frames: of a recovery point, at which decoding can begin too, how many frames after this one
    pictures are whole again, whatever was lost before: to the bit those of the whole stream; None for other packets.
    """

    data: bytes = field(repr=False)
    frame: int
    starts: bool
    recovery_frames: int | None = None

    @property
    def whole_from(self) -> int | None:
        """The frame from which pictures are whole for who begins here; None where nobody can."""
        if self.starts:
            return self.frame
        return None if self.recovery_frames is None else self.frame + self.recovery_frames


MOST_RECOVERY_FRAMES: Final = 1 << 16


def is_recovery(value: object) -> bool:
    """Whether this can be the `recovery_frames` of a packet."""
    return value is None or (type(value) is int and 0 <= value <= MOST_RECOVERY_FRAMES)


@dataclass(frozen=True)
class Picture:
    """What a decoder makes of one picture of the session; `image` is None where it is `missing`."""

    frame: int
    state: PictureState
    image: Image | None = field(repr=False)


class StreamEncoder(ABC):
    """One sequence being encoded."""

    @abstractmethod
    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        """The packets that are ready after this picture, which is left untouched; none while pictures are held back.

        Raises ImageError for an image outside the codec's capabilities, or of another shape than the first.
        """

    @abstractmethod
    def flush(self) -> list[Packet]:
        """The packets of pictures still held back; the session is over then."""


class StreamDecoder(ABC):
    """One stream being decoded, from a packet that `starts` on, or a recovery point; pictures before it are missing."""

    @abstractmethod
    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        """The pictures that are ready after this packet, or after knowing that the next one is LOST.

        Never claims `whole` for a picture that depends on what was lost. Raises BitstreamError for damaged or foreign
        bytes that it can tell; the session goes on with the next packet that `starts` or is a recovery point.
        """

    @abstractmethod
    def flush(self) -> list[Picture]:
        """The pictures still held back; the session is over then."""


class StreamCodec(AnyCodec[P]):
    """Base class of codecs with memory. Equal pictures, pushed in the same order, give equal packets."""

    @abstractmethod
    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        """A session for one sequence, which knows nothing of any other."""

    @abstractmethod
    def decoder(self) -> StreamDecoder:
        """A session for one stream that any instance of this class encoded, from its packets alone."""

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        """Raises Unsupported, which tells an evaluator that was written for codecs of single pictures what to call."""
        raise _has_memory(self)

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        """Raises Unsupported, as `encode` does."""
        raise _has_memory(self)

    def is_low_delay(self) -> bool:
        """Whether each pushed picture gives its packet at once, and each packet its picture at once."""
        return True


def _has_memory(codec: AnyCodec[Any]) -> Unsupported:
    return Unsupported(
        f"{codec.name} has memory between frames, so no picture is coded on its own; an evaluator pushes frames into a "
        f"session: encoder_of(codec, sequence.frame_rate_hz) and decoder_of(codec), of any codec"
    )


def encoder_of(codec: AnyCodec[Any], frame_rate_hz: float) -> StreamEncoder:
    """A session of any codec, which extracts features where it is one of these. Raises TypeError for no codec."""
    if isinstance(codec, StreamCodec):
        return codec.encoder(frame_rate_hz)
    if isinstance(codec, FeatureCodec):
        return _ExtractingEncoder(codec)
    return _StandaloneEncoder(_still(codec))


def decoder_of(codec: AnyCodec[Any]) -> StreamDecoder:
    """A session of any codec of pictures. Raises Unsupported for one of features, and TypeError for no codec."""
    if isinstance(codec, FeatureCodec):
        raise sends_no_picture(codec)
    return codec.decoder() if isinstance(codec, StreamCodec) else _StandaloneDecoder(_still(codec))


def _still(codec: object) -> Codec[Any]:
    if not isinstance(codec, Codec):
        kinds = "a Codec nor a StreamCodec nor a FeatureCodec"
        raise TypeError(f"{type(codec).__name__} is neither {kinds}; subclass one of them")
    return codec


class _ExtractingEncoder(StreamEncoder):
    """What a device does with a codec of features."""

    def __init__(self, codec: FeatureCodec[Any]) -> None:
        self._codec, self._encoder = codec, codec.encoder()

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        return [self._encoder.push(self._codec.extract(image))]

    def flush(self) -> list[Packet]:
        return []


class _StandaloneEncoder(StreamEncoder):
    def __init__(self, codec: Codec[Any]) -> None:
        self._codec, self._pushed = codec, 0

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        packet = Packet(self._codec.encode(image, trace=trace), self._pushed, starts=True)
        self._pushed += 1
        return [packet]

    def flush(self) -> list[Packet]:
        return []


class _StandaloneDecoder(StreamDecoder):
    """Each packet gives its picture; a lost one is missing, numbered after the one before it."""

    def __init__(self, codec: Codec[Any]) -> None:
        self._codec, self._next = codec, 0

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        if isinstance(packet, Loss):
            self._next += 1
            return [Picture(self._next - 1, "missing", None)]
        self._next = packet.frame + 1
        return [Picture(packet.frame, "whole", self._codec.decode(packet.data, trace=trace))]

    def flush(self) -> list[Picture]:
        return []
