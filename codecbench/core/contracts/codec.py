"""The codec contract: three ways of writing a codec, and one way of using it.

One class is one codec, and an instance of it one setting.

A `Codec` codes pictures one by one by `encode` and `decode`; a `StreamCodec` writes sessions, which remember what came
before; a `FeatureCodec` finds features and writes sessions for these. Whoever uses a codec opens sessions of any of
them: frames go in and packets come out, packets go in and pictures or features come out. A picture that is coded on its
own is a packet of its own. What a codec is, `carries` and `stateless` say.

Codecs are silent about time and quality: others measure. Bitstreams are self-contained: a decoder gets packets and
nothing else, so no table, shape or quality may reach it outside the bytes that are counted.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Protocol, Self, TypeAlias, cast

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.features import FeatureDecoder, FeatureEncoder, Features, FeatureSet
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Configured, P
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.contracts.stream import Loss, Packet, Picture, StreamDecoder, StreamEncoder
from codecbench.core.counting.trace import NULL_TRACE, Trace

Reference = Literal["", "baseline", "anchor"]

Architecture = Literal["cta", "features"]
"""Who analyses: `cta`, the server does, on whatever the codec sends; `features`, the same, and that is features."""

Decoded: TypeAlias = Picture | FeatureSet
"""What comes of a packet."""


class Decoder(Protocol):
    """A stream of any codec being decoded: a `StreamDecoder`, or one that gives a FeatureSet for each packet."""

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> Sequence[Decoded]:
        """What is ready after this packet, or after knowing that the next one is LOST."""

    def flush(self) -> Sequence[Decoded]:
        """What was held back; the session is over then."""


@dataclass(frozen=True)
class Capabilities:
    """What a codec can do, checked before anything runs.

    channels: layouts of images that it takes (1 gray, 3 RGB). A layout that is missing makes the cell `unsupported`.
    lossless: every setting returns the very pixels; for codecs where it depends, override `Codec.is_lossless`.
    counts_operations: all arithmetic is in kernels run through the trace; False means opaque (foreign library).
    thread_safe: one instance may encode and decode from several threads at once.
    partial_decoding: `Codec.decode_partial` makes something of a bitstream of which parts are missing.
    """

    channels: tuple[int, ...] = (1, 3)
    lossless: bool = False
    counts_operations: bool = False
    thread_safe: bool = True
    partial_decoding: bool = False


@dataclass(frozen=True)
class Fragment:
    """Bytes of a bitstream that are there. offset: where in it they begin."""

    offset: int
    data: bytes = field(repr=False)

    @property
    def end(self) -> int:
        """Where in the bitstream they end."""
        return self.offset + len(self.data)


@dataclass(frozen=True)
class PartialImage:
    """What a decoder makes of a bitstream of which parts are missing.

    image: of the encoded image's shape. whole: (H, W) where it is what the whole bitstream gives; elsewhere it is
    coarser than that, or made up.
    """

    image: Image = field(repr=False)
    whole: NDArray[np.bool_] = field(repr=False)

    @classmethod
    def of_whole(cls, image: Image) -> Self:
        """Nothing was missing."""
        return cls(image, np.ones(image.shape[:2], dtype=bool))


class AnyCodec(Configured[P]):
    """What codecs of pictures, of streams and of features have in common, and how all are used.

    Class attributes: `name` as used in a matrix; `version`, raised whenever bitstreams or decoded pixels
    change, so that stored cells are recomputed; `params_type`; `capabilities`; `examples`, parameters of the
    settings on which the conformance kit and the benchmarks exercise this codec; `reference`, what it is to
    others: the `baseline` that a task without compression is judged by, or the `anchor` of rates; `kernels`, the
    packages, modules and functions whose listed kernels it calls, which a run compiles ahead; a setting that calls
    fewer has its own. The classes below say the rest: `carries`, what its packets carry, and `stateless`, whether each
    picture is coded on its own, so that `encode` and `decode` may be called too.
    """

    capabilities: ClassVar[Capabilities]
    examples: ClassVar[tuple[dict[str, Any], ...]] = ({},)
    kernels: tuple[str, ...] = ()
    reference: ClassVar[Reference] = ""
    carries: ClassVar[Literal["pictures", "features"]] = "pictures"
    stateless: ClassVar[bool] = False

    @abstractmethod
    def open_encoder(self, frame_rate_hz: float) -> StreamEncoder:
        """A session that takes the frames of one sequence and gives packets."""

    @abstractmethod
    def open_decoder(self) -> Decoder:
        """A session that takes the packets of one stream, which any instance of this class encoded."""

    def is_lossless(self) -> bool:
        """Whether this setting returns the very pixels that went in."""
        return self.capabilities.lossless

    def remark(self) -> str:
        """What readers of results are to know of this setting beside all numbers, in a few words; empty for nothing.

        Every table says it, so it is for properties without which numbers cannot be compared, such as the pixel format.
        """
        return ""

    def libraries(self) -> dict[str, str]:
        """Foreign libraries whose version can change the bytes, as name -> version. Recorded with every run."""
        return {}

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        """What one pastes into a robot to send what this setting sends; by default a call of codecbench itself."""
        given = self.params.model_dump(mode="json", exclude_defaults=True)
        if type(self.params).model_validate(given) != self.params:  # where one parameter sets another's default
            given = self.params.model_dump(mode="json")
        values = "".join(f", {name}={value!r}" for name, value in given.items())
        layout = "gray" if scene.channels == 1 else "rgb"
        text = f"""import codecbench

codec = codecbench.codec({self.name!r}{values})
session = codecbench.encoder_of(codec, {scene.frame_rate_hz:g})


def encode({layout}):
    packets = session.flush() if {layout} is None else session.push({layout})
    return b"".join(packet.data for packet in packets)"""
        note = f"No element of ROS 2, GStreamer or FFmpeg is known to code what {self.name} codes."
        return (Recipe("Python, codecbench", "python", text, note),)

    def is_low_delay(self) -> bool:
        """Whether each pushed picture gives its packet at once, and each packet its picture at once."""
        return True

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        """The bitstream of one image, of a stateless codec; others raise Unsupported, which names what to call."""
        raise self._sessions_only()

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        """The image of one bitstream, of a stateless codec; others raise Unsupported."""
        raise self._sessions_only()

    def _sessions_only(self) -> Unsupported:
        if self.carries == "features":
            return sends_no_picture(self)
        return Unsupported(
            f"{self.name} has memory between frames, so no picture is coded on its own; an evaluator pushes frames "
            f"into a session: encoder_of(codec, sequence.frame_rate_hz) and decoder_of(codec), of any codec"
        )

    def decode_partial(self, fragments: Sequence[Fragment], *, trace: Trace = NULL_TRACE) -> PartialImage:
        """The image of a bitstream as far as the fragments of it go; for codecs with `capabilities.partial_decoding`.

        fragments: one or more, undamaged, in order and with a gap before each but the first; how much is missing after
        the last is not known. A whole bitstream, as one fragment, gives what `decode` gives. Raises BitstreamError
        where nothing can be made of them, which for a setting may be whenever anything is missing.
        """
        raise Unsupported(f"{self.name} decodes nothing of a bitstream of which parts are missing")

    def with_params(self, **values: Any) -> Self:
        """The setting with these parameters in place of its own. Raises pydantic.ValidationError."""
        return type(self)(type(self).params_type.model_validate({**self.params.model_dump(), **values}))  # type: ignore[arg-type]

    def at_encoder(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What `function(codec, *arguments)` returns in the process that encodes; a function of a module's own.

        A codec of another distribution encodes in a process of its own, where times and operations are measured.
        """
        return function(self, *arguments)

    def at_decoder(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """The same in the process that decodes, which never sees a frame that was encoded."""
        return function(self, *arguments)

    def prepared(self, image: Image) -> Self:
        """This setting with all found that `encode` would search for on this image: the rate that reaches a size, say.

        `codec.prepared(image).encode(image)` gives the bytes of `codec.encode(image)` by one encoding, which is what
        is timed. It is for that image alone; this instance stays as it is. A codec that searches for nothing returns
        itself. Raises what `encode` raises.
        """
        return self


class Codec(AnyCodec[P]):
    """Base class of codecs that code each picture on its own, by an instance that remembers nothing."""

    stateless = True

    @abstractmethod
    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        """The bitstream of one image, which is left untouched.

        Raises ImageError for an image outside `capabilities`. Equal images give equal bytes.
        """

    @abstractmethod
    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        """The image of a bitstream that any instance of this class encoded, from the bytes alone.

        Returns uint8 of the encoded image's shape. Raises BitstreamError for damaged or foreign bytes.
        """

    def open_encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return _StandaloneEncoder(self)

    def open_decoder(self) -> StreamDecoder:
        return _StandaloneDecoder(self)


class StreamCodec(AnyCodec[P]):
    """Base class of codecs with memory. Equal pictures, pushed in the same order, give equal packets."""

    @abstractmethod
    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        """A session for one sequence, which knows nothing of any other."""

    @abstractmethod
    def decoder(self) -> StreamDecoder:
        """A session for one stream that any instance of this class encoded, from its packets alone."""

    def open_encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return self.encoder(frame_rate_hz)

    def open_decoder(self) -> StreamDecoder:
        return self.decoder()


class FeatureCodec(AnyCodec[P]):
    """Base class of codecs of features. Equal images, in the same order, give equal packets.

    A lossless setting gives back positions, levels and descriptors to the bit, in any order, and angles to within
    ANGLE_TOLERANCE_RAD; responses need not come back.
    """

    carries = "features"

    @abstractmethod
    def extract(self, image: Image) -> Features:
        """What the device finds in an image, gray or RGB, which is left untouched.

        Raises ImageError for an image outside `capabilities`. Equal images give equal features.
        """

    @abstractmethod
    def encoder(self) -> FeatureEncoder:
        """A session for one sequence, which knows nothing of any other."""

    @abstractmethod
    def decoder(self) -> FeatureDecoder:
        """A session for one stream that any instance of this class encoded, from its packets alone."""

    def open_encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return _ExtractingEncoder(self)

    def open_decoder(self) -> Decoder:
        return _SetDecoder(self.decoder())


class _ExtractingEncoder(StreamEncoder):
    """What a device does with a codec of features."""

    def __init__(self, codec: FeatureCodec[Any]) -> None:
        self._codec, self._encoder = codec, codec.encoder()

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        return [self._encoder.push(self._codec.extract(image))]

    def flush(self) -> list[Packet]:
        return []


class _SetDecoder:
    """Each packet gives its set at once."""

    def __init__(self, decoder: FeatureDecoder) -> None:
        self._decoder = decoder

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[FeatureSet]:
        return [self._decoder.push(packet)]

    def flush(self) -> list[FeatureSet]:
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


def encoder_of(codec: AnyCodec[Any], frame_rate_hz: float) -> StreamEncoder:
    """A session of any codec, which extracts features where it is one of these. Raises TypeError for no codec."""
    return _codec(codec).open_encoder(frame_rate_hz)


def decoder_of(codec: AnyCodec[Any]) -> StreamDecoder:
    """A session of any codec of pictures. Raises Unsupported for one of features, and TypeError for no codec."""
    if _codec(codec).carries == "features":
        raise sends_no_picture(codec)
    return cast("StreamDecoder", codec.open_decoder())


def _codec(codec: object) -> AnyCodec[Any]:
    if not isinstance(codec, AnyCodec):
        kinds = "a Codec nor a StreamCodec nor a FeatureCodec"
        raise TypeError(f"{type(codec).__name__} is neither {kinds}; subclass one of them")
    return codec


def gets_features(codec: AnyCodec[Any], architecture: str) -> bool:
    """Whether who analyses what a codec sends gets features: so it is with codecs of features, whatever was asked for.

    Raises Unsupported where `architecture` is `features` and the codec is of pictures.
    """
    if codec.carries == "features":
        return True
    if architecture == "features":
        raise sends_no_features(codec)
    return False


def sends_no_picture(codec: AnyCodec[Any]) -> Unsupported:
    """For who asks a codec of features for a picture."""
    return Unsupported(
        f"{codec.name} sends features, so that there is no picture to look at; "
        f"measure it by what reads features: docs/pictures-or-features.md says what does"
    )


def sends_no_features(codec: AnyCodec[Any]) -> Unsupported:
    """For who asks a codec of pictures for features."""
    return Unsupported(
        f"{codec.name} sends pictures, not features; "
        f"leave `architecture: features` out, and each codec is measured by what it sends"
    )
