"""The codec contract: three ways of writing a codec, and one way of using it.

A class is a codec; an instance of it is one operating point, called a setting.

A `Codec` codes each frame on its own by `encode` and `decode`. A `StreamCodec` is an inter-frame (video) codec: its
sessions hold state. A `FeatureCodec` extracts features and opens sessions that code them. All are used
through sessions: frames go in and packets come out, then packets go in and decoded frames or features come out. A
stateless codec makes one packet a frame. `carries` and `stateless` tell the kinds apart.

Codecs measure neither time nor quality: evaluators do. Bitstreams are self-contained: a decoder gets packets and
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
from codecbench.core.contracts.image import LAYOUTS, Image, Layout
from codecbench.core.contracts.params import Configured, P
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.contracts.stream import Loss, Packet, Picture, StreamDecoder, StreamEncoder
from codecbench.core.counting.trace import NULL_TRACE, Trace

Reference = Literal["", "baseline", "anchor"]

Architecture = Literal["cta", "features"]
"""What the server analyzes: `cta` (compress-then-analyze), whatever the codec sends; `features`, features only."""

Decoded: TypeAlias = Picture | FeatureSet
"""What a decoder returns for a packet."""


class Decoder(Protocol):
    """A decoding session of any codec: a `StreamDecoder`, or one that returns a FeatureSet for each packet."""

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> Sequence[Decoded]:
        """Decode the next packet, or LOST in its place; return what is ready."""

    def flush(self) -> Sequence[Decoded]:
        """Return what the decoder still held back, and end the session."""


@dataclass(frozen=True)
class Capabilities:
    """What a codec can do, checked before anything runs."""

    channels: tuple[int, ...] = (1, 3)
    """Image layouts that it takes: 1 gray, 3 RGB. Cells of other layouts are `unsupported`."""
    bits: tuple[int, ...] = (8,)
    """Bits of the samples that it takes: 8, 16 or both. Images of 16 bits are gray."""
    lossless: bool = False
    """Every setting returns the exact pixels. If that depends on parameters, override `is_lossless`."""
    counts_operations: bool = False
    """All arithmetic is in kernels run through the trace; False for codecs of a foreign library."""
    thread_safe: bool = True
    """One instance may encode and decode from several threads at once."""
    partial_decoding: bool = False
    """`decode_partial` decodes bitstreams of which parts are missing."""

    @property
    def layouts(self) -> tuple[Layout, ...]:
        """All layouts that it takes, in the order of LAYOUTS."""
        return tuple(layout for layout in LAYOUTS if layout.channels in self.channels and layout.bits in self.bits)


@dataclass(frozen=True)
class Fragment:
    """A contiguous part of a bitstream that arrived."""

    offset: int
    """Position of its first byte in the bitstream."""
    data: bytes = field(repr=False)

    @property
    def end(self) -> int:
        """Position after its last byte in the bitstream."""
        return self.offset + len(self.data)


@dataclass(frozen=True)
class PartialImage:
    """An image decoded from a bitstream of which parts are missing."""

    image: Image = field(repr=False)
    """The image, of the encoded image's shape."""
    whole: NDArray[np.bool_] = field(repr=False)
    """(H, W) True for pixels that equal the complete bitstream's; the others are coarser or concealed."""

    @classmethod
    def of_whole(cls, image: Image) -> Self:
        """Wrap an image of which nothing was missing."""
        return cls(image, np.ones(image.shape[:2], dtype=bool))


class AnyCodec(Configured[P]):
    """Base of the three kinds of codec, with what all have in common; subclass one of those.

    Raise `version` whenever bitstreams or decoded pixels change.
    """

    capabilities: ClassVar[Capabilities]
    """What it can do."""
    examples: ClassVar[tuple[dict[str, Any], ...]] = ({},)
    """Parameters of the settings on which the conformance kit and the benchmarks run this codec."""
    kernels: tuple[str, ...] = ()
    """Packages, modules and functions whose kernels a run compiles ahead; a setting that calls fewer sets its own."""
    reference: ClassVar[Reference] = ""
    """Marks the codec as the uncompressed `baseline` or the BD-rate `anchor`; empty for all others."""
    carries: ClassVar[Literal["pictures", "features"]] = "pictures"
    """What its packets carry."""
    stateless: ClassVar[bool] = False
    """Whether each frame is coded on its own, so that `encode` and `decode` work too."""

    @abstractmethod
    def open_encoder(self, frame_rate_hz: float) -> StreamEncoder:
        """Open a session that encodes the frames of one sequence into packets."""

    @abstractmethod
    def open_decoder(self) -> Decoder:
        """Open a session that decodes the packets of one stream, encoded by any instance of this class."""

    def is_lossless(self) -> bool:
        """Return whether this setting reproduces the exact pixels."""
        return self.capabilities.lossless

    def remark(self) -> str:
        """Return a few words that every table shows beside this setting's numbers; empty for none.

        Use it for properties without which numbers cannot be compared, such as the pixel format.
        """
        return ""

    def remark_at(self, bits: int) -> str:
        """Return the remark on frames of 8 or 16 bits a sample; by default `remark`."""
        return self.remark()

    def libraries(self) -> dict[str, str]:
        """Return the foreign libraries whose version can change the bytes, as name -> version. A run records them."""
        return {}

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        """Return code that sends the same bytes from a robot's stack; by default a call of codecbench itself."""
        values_set = self.params.model_dump(mode="json", exclude_defaults=True)
        if type(self.params).model_validate(values_set) != self.params:  # if one parameter sets another's default
            values_set = self.params.model_dump(mode="json")
        values = "".join(f", {name}={value!r}" for name, value in values_set.items())
        layout = "gray" if scene.channels == 1 else "rgb"
        text = f"""import codecbench

codec = codecbench.codec({self.name!r}{values})
session = codecbench.encoder_of(codec, {scene.frame_rate_hz:g})


def encode({layout}):
    packets = session.flush() if {layout} is None else session.push({layout})
    return b"".join(packet.data for packet in packets)"""
        note = f"No element of ROS 2, GStreamer or FFmpeg is known to implement {self.name}."
        return (Recipe("Python, codecbench", "python", text, note),)

    def is_low_delay(self) -> bool:
        """Return whether every pushed frame yields its packet at once, and every packet its frame."""
        return True

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        """Encode one image. Raises Unsupported, naming what to call, if the codec is not stateless."""
        raise self._sessions_only()

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        """Decode one bitstream. Raises Unsupported if the codec is not stateless."""
        raise self._sessions_only()

    def _sessions_only(self) -> Unsupported:
        if self.carries == "features":
            return sends_no_picture(self)
        return Unsupported(
            f"{self.name} is an inter-frame codec and cannot code single frames; use sessions, as for any codec: "
            "encoder_of(codec, sequence.frame_rate_hz) and decoder_of(codec)"
        )

    def decode_partial(self, fragments: Sequence[Fragment], *, trace: Trace = NULL_TRACE) -> PartialImage:
        """Decode the fragments of a bitstream that arrived; for codecs with `capabilities.partial_decoding`.

        fragments: one or more, undamaged, in order and with a gap before each but the first; how much is missing after
        the last is unknown. A complete bitstream, as one fragment, gives what `decode` gives. Raises BitstreamError if
        nothing can be decoded, which for some settings is whenever anything is missing.
        """
        raise Unsupported(f"{self.name} cannot decode a bitstream with missing parts")

    def with_params(self, **values: Any) -> Self:
        """Return this setting with some parameters replaced. Raises pydantic.ValidationError."""
        return type(self)(type(self).params_type.model_validate({**self.params.model_dump(), **values}))  # type: ignore[arg-type]

    def at_encoder(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return `function(codec, *arguments)`, called in the process that encodes; `function` is a module's own.

        A codec of another distribution encodes in a process of its own, where times and operations are measured.
        """
        return function(self, *arguments)

    def at_decoder(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """Return the same, called in the process that decodes, which never sees an original frame."""
        return function(self, *arguments)

    def prepared(self, image: Image) -> Self:
        """Return this setting with the result of any search that `encode` does on this image, such as a target size.

        `codec.prepared(image).encode(image)` returns the bytes of `codec.encode(image)` by a single encoding, which is
        what is timed. It is valid for that image only; this instance does not change. A codec that searches for nothing
        returns itself. Raises what `encode` raises.
        """
        return self


class Codec(AnyCodec[P]):
    """Base class of stateless codecs, which code each frame on its own."""

    stateless = True

    @abstractmethod
    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        """Encode one image, without writing to it. Equal images give equal bytes.

        Raises ImageError for an image outside `capabilities`.
        """

    @abstractmethod
    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        """Decode a bitstream of any instance of this class, from the bytes alone.

        Returns an image of the encoded one's shape and dtype. Raises BitstreamError for damaged or foreign bytes.
        """

    def open_encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return _StandaloneEncoder(self)

    def open_decoder(self) -> StreamDecoder:
        return _StandaloneDecoder(self)


class StreamCodec(AnyCodec[P]):
    """Base class of inter-frame (video) codecs. Equal frames, pushed in the same order, give equal packets."""

    @abstractmethod
    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        """Open an encoding session for one sequence, independent of all others."""

    @abstractmethod
    def decoder(self) -> StreamDecoder:
        """Open a decoding session for one stream of any instance of this class, from its packets alone."""

    def open_encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return self.encoder(frame_rate_hz)

    def open_decoder(self) -> StreamDecoder:
        return self.decoder()


class FeatureCodec(AnyCodec[P]):
    """Base class of feature codecs. Equal images, in the same order, give equal packets.

    A lossless setting reproduces positions, levels and descriptors to the bit, in any order, and angles to within
    ANGLE_TOLERANCE_RAD; responses need not be sent.
    """

    carries = "features"

    @abstractmethod
    def extract(self, image: Image) -> Features:
        """Extract the features of an image, gray or RGB, without writing to it. Equal images give equal features.

        Raises ImageError for an image outside `capabilities`.
        """

    @abstractmethod
    def encoder(self) -> FeatureEncoder:
        """Open an encoding session for one sequence, independent of all others."""

    @abstractmethod
    def decoder(self) -> FeatureDecoder:
        """Open a decoding session for one stream of any instance of this class, from its packets alone."""

    def open_encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return _ExtractingEncoder(self)

    def open_decoder(self) -> Decoder:
        return _SetDecoder(self.decoder())


class _ExtractingEncoder(StreamEncoder):
    """The device's side of a feature codec: extracts the features of each frame and encodes them."""

    def __init__(self, codec: FeatureCodec[Any]) -> None:
        self._codec, self._encoder = codec, codec.encoder()

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        return [self._encoder.push(self._codec.extract(image))]

    def flush(self) -> list[Packet]:
        return []


class _SetDecoder:
    """Decodes each packet into its feature set at once."""

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
    """Decodes each packet into its frame; the frame of a lost packet is missing, and numbered by its place."""

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
    """Open an encoding session of any codec; a feature codec's extracts features. Raises TypeError for no codec."""
    return _codec(codec).open_encoder(frame_rate_hz)


def decoder_of(codec: AnyCodec[Any]) -> StreamDecoder:
    """Open a decoding session of any codec but a feature codec.

    Raises Unsupported for a feature codec, and TypeError for no codec.
    """
    if _codec(codec).carries == "features":
        raise sends_no_picture(codec)
    return cast("StreamDecoder", codec.open_decoder())


def _codec(codec: object) -> AnyCodec[Any]:
    if not isinstance(codec, AnyCodec):
        kinds = "a Codec nor a StreamCodec nor a FeatureCodec"
        raise TypeError(f"{type(codec).__name__} is neither {kinds}; subclass one of them")
    return codec


def gets_features(codec: AnyCodec[Any], architecture: str) -> bool:
    """Return whether the server gets features of this codec: those of a feature codec, whatever the architecture.

    Raises Unsupported if `architecture` is `features` and the codec sends frames.
    """
    if codec.carries == "features":
        return True
    if architecture == "features":
        raise sends_no_features(codec)
    return False


def sends_no_picture(codec: AnyCodec[Any]) -> Unsupported:
    """Return the error for asking a feature codec for a frame."""
    return Unsupported(
        f"{codec.name} sends features, not frames; use evaluators that read features: see docs/pictures-or-features.md"
    )


def sends_no_features(codec: AnyCodec[Any]) -> Unsupported:
    """Return the error for asking a codec that sends frames for features."""
    return Unsupported(
        f"{codec.name} sends frames, not features; "
        f"leave out `architecture: features` to measure each codec by what it sends"
    )
