"""Shared parts of the checks: sessions of any kind of codec, and comparisons of their results.

A frame that is coded on its own is a session of one packet. A packet decodes to an image or a feature set: checks read
it by `state_of` and `content_of`, and compare by `require_same`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np

from codecbench.core.conformance.material import FRAME_RATE_HZ, Film
from codecbench.core.conformance.sandbox import Verb, sandbox
from codecbench.core.contracts.codec import AnyCodec, Decoded
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.features import Features, FeatureSet
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Loss, Packet, Picture
from codecbench.core.counting.trace import NULL_TRACE, Trace

CodecClass = type[AnyCodec[Any]]
Shape = Literal["pictures", "stream", "features"]
"""What a codec codes: frames on their own, streams of frames, or features."""

FEATURE_ARRAYS: Final = ("pixels", "octaves", "angles", "responses", "descriptors")
_TIMEOUT_S: Final = 120.0
_MEMORY_MB: Final = 2048


class ConformanceFailure(AssertionError):
    """A plugin breaks the contract."""

    def __init__(self, where: str, got: object, expected: str) -> None:
        """where: what was checked, on what. got, expected: the result, and what it should have been."""
        super().__init__(f"{where}: got {got}; expected {expected}")
        self.where = where
        self.got = got
        self.expected = expected


class NotClaimed(Exception):
    """The check does not apply: the codec, or this setting, does not claim what it checks; the text says what."""


CheckFunction = Callable[[CodecClass, Params, Sequence[Film]], None]


@dataclass(frozen=True)
class Check:
    """A named check for codecs of some shapes."""

    name: str
    proves: str
    """What passing it proves, as a sentence."""
    function: CheckFunction
    """Takes the class, a setting and films of one layout; raises ConformanceFailure if the codec breaks the contract.
    """
    shapes: tuple[Shape, ...]


def shape_of(codec_class: CodecClass) -> Shape:
    """Return the contract that a codec class implements."""
    if codec_class.carries == "features":
        return "features"
    return "pictures" if codec_class.stateless else "stream"


def packets_of(codec: AnyCodec[Any], pictures: Sequence[Image], trace: Trace = NULL_TRACE) -> list[Packet]:
    """Encode frames in one session; return its packets in sending order."""
    session = codec.open_encoder(FRAME_RATE_HZ)
    return [packet for picture in pictures for packet in session.push(picture, trace=trace)] + session.flush()


def decoded_of(codec: AnyCodec[Any], packets: Sequence[Packet | Loss], trace: Trace = NULL_TRACE) -> list[Decoded]:
    """Decode packets in one session; return its results in order."""
    session = codec.open_decoder()
    return [result for packet in packets for result in session.push(packet, trace=trace)] + list(session.flush())


def encode_films(codec: AnyCodec[Any], films: Sequence[Film]) -> Iterator[tuple[Film, list[Packet]]]:
    """Yield the films that the codec supports, each with its packets.

    A single image may be Unsupported, for example if it is too small for a rate, but not every one of a layout.
    """
    supported, reasons = 0, []
    for film in films:
        try:
            packets = packets_of(codec, film.pictures)
        except Unsupported as error:
            if len(film.pictures) > 1:
                raise
            reasons.append(f"{film.name}: {error}")
            continue
        supported += 1
        yield film, packets
    if not supported:
        got = f"Unsupported for every image ({'; '.join(reasons[:2])})"
        raise ConformanceFailure("encoding", got, "some bitstreams")


def content_of(result: Decoded) -> Image | Features | None:
    """Return the image or the features of a decoder's result; None if they are missing."""
    return result.features if isinstance(result, FeatureSet) else result.image


def state_of(result: Decoded) -> str:
    """Return the state of a decoder's result; features are never concealed, only `whole` or `missing`."""
    if isinstance(result, FeatureSet):
        return "missing" if result.features is None else "whole"
    return result.state


def whole_contents(where: str, decoded: Sequence[Decoded]) -> dict[int, Any]:
    """Return contents by frame. Fails if one is not whole or occurs twice."""
    contents: dict[int, Any] = {}
    for result in decoded:
        if type(result) not in (Picture, FeatureSet):
            raise ConformanceFailure(where, type(result).__name__, "a Picture or a FeatureSet")
        content = content_of(result)
        if state_of(result) != "whole" or content is None:
            raise ConformanceFailure(where, f"frame {result.frame} is {state_of(result)}", "whole: nothing was lost")
        if isinstance(result, FeatureSet) and type(content) is not Features:
            raise ConformanceFailure(where, type(content).__name__, "Features")
        if result.frame in contents:
            raise ConformanceFailure(where, f"frame {result.frame} twice", "each frame once")
        contents[result.frame] = content
    return contents


def require_same_packets(where: str, got: Sequence[Packet], expected: Sequence[Packet]) -> None:
    """Fail unless the packets of two sessions are equal."""
    if len(got) != len(expected):
        raise ConformanceFailure(where, f"{len(got)} packets", f"{len(expected)}")
    for index, (left, right) in enumerate(zip(got, expected, strict=True)):
        if left != right:
            what = "other bytes" if left.data != right.data else f"frame {left.frame}, starts={left.starts}"
            raise ConformanceFailure(f"{where}, packet {index}", what, "the same packet")


def require_same(where: str, got: Any, expected: Any) -> None:
    """Fail unless two images, or two feature sets in order, are equal to the bit."""
    if isinstance(expected, Features):
        _require_same_features(where, got, expected)
        return
    if got.shape != expected.shape:
        raise ConformanceFailure(where, f"shape {got.shape}", f"shape {expected.shape}")
    if not np.array_equal(got, expected):
        index = tuple(int(i) for i in np.argwhere(got != expected)[0])
        count = int(np.count_nonzero(got != expected))
        raise ConformanceFailure(where, f"{got[index]} at {index}, {count} samples differ", f"{expected[index]} there")


def _require_same_features(where: str, got: Features, expected: Features) -> None:
    if got.size != expected.size or len(got) != len(expected):
        counts = [f"{len(features)} features of {features.size[0]}x{features.size[1]}" for features in (got, expected)]
        raise ConformanceFailure(where, *counts)
    for name in FEATURE_ARRAYS:
        if not np.array_equal(getattr(got, name), getattr(expected, name), equal_nan=name != "descriptors"):
            raise ConformanceFailure(where, f"other {name}", "the same features")


def require_same_contents(where: str, got: Sequence[Decoded], expected: Sequence[Decoded], first: int = 0) -> None:
    """Fail unless two sessions decoded the same whole contents from frame `first` on."""
    contents = whole_contents(where, [result for result in got if type(result.frame) is int and result.frame >= first])
    references = {frame: content for frame, content in whole_contents(where, expected).items() if frame >= first}
    if sorted(contents) != sorted(references):
        raise ConformanceFailure(where, f"the frames {sorted(contents)}", f"{sorted(references)}")
    for frame, content in contents.items():
        require_same(f"{where}, frame {frame}", content, references[frame])


def run_elsewhere(
    verb: Verb,
    where: str,
    function: Callable[..., Any],
    *arguments: Any,
    expected: str = "the result of this process",
    timeout_s: float = _TIMEOUT_S,
    memory_mb: int = _MEMORY_MB,
) -> Any:
    """Call a function in another process and return its result. Fails if it returns none."""
    reply = sandbox(verb).call(function, *arguments, timeout_s=timeout_s, memory_mb=memory_mb)
    if reply.status != "done":
        raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", expected)
    return reply.value
