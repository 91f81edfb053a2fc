"""What all checks share: the sessions of a codec of any kind, and when two of them gave the same.

Pictures that are coded on their own are sessions of one packet. What a packet gives back is an image, or a set of
features; checks ask `state_of` and `content_of`, and compare by `require_same`.
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
"""What a codec codes: pictures on their own, pictures with memory between them, or features."""

FEATURE_ARRAYS: Final = ("pixels", "octaves", "angles", "responses", "descriptors")
_TIMEOUT_S: Final = 120.0
_MEMORY_MB: Final = 2048


class ConformanceFailure(AssertionError):
    """A plugin breaks the contract: what was being checked, on what, what came and what should have come."""

    def __init__(self, where: str, got: object, expected: str) -> None:
        super().__init__(f"{where}: got {got}; expected {expected}")
        self.where = where
        self.got = got
        self.expected = expected


class NotClaimed(Exception):
    """The check is about something that the codec, or this setting of it, does not claim; the text says what."""


CheckFunction = Callable[[CodecClass, Params, Sequence[Film]], None]


@dataclass(frozen=True)
class Check:
    """A named check: what it proves of codecs of some shapes.

    function: takes the class, a setting and films of one layout; raises ConformanceFailure where a codec falls short.
    """

    name: str
    proves: str
    function: CheckFunction
    shapes: tuple[Shape, ...]


def shape_of(codec_class: CodecClass) -> Shape:
    """By which contract a codec goes."""
    if codec_class.carries == "features":
        return "features"
    return "pictures" if codec_class.stateless else "stream"


def packets_of(codec: AnyCodec[Any], pictures: Sequence[Image], trace: Trace = NULL_TRACE) -> list[Packet]:
    """All packets of a session, in the order in which they leave."""
    session = codec.open_encoder(FRAME_RATE_HZ)
    return [packet for picture in pictures for packet in session.push(picture, trace=trace)] + session.flush()


def decoded_of(codec: AnyCodec[Any], packets: Sequence[Packet | Loss], trace: Trace = NULL_TRACE) -> list[Decoded]:
    """What comes of all packets of a session, in order."""
    session = codec.open_decoder()
    return [shown for packet in packets for shown in session.push(packet, trace=trace)] + list(session.flush())


def encoded(codec: AnyCodec[Any], films: Sequence[Film]) -> Iterator[tuple[Film, list[Packet]]]:
    """The films that the codec takes, each with its packets.

    A single picture may be Unsupported (too small for a rate, say), but not every one of a layout.
    """
    taken, reasons = 0, []
    for film in films:
        try:
            packets = packets_of(codec, film.pictures)
        except Unsupported as error:
            if len(film.pictures) > 1:
                raise
            reasons.append(f"{film.name}: {error}")
            continue
        taken += 1
        yield film, packets
    if not taken:
        got = f"Unsupported for every image ({'; '.join(reasons[:2])})"
        raise ConformanceFailure("encoding", got, "some bitstreams")


def content_of(shown: Decoded) -> Image | Features | None:
    """The image or the features."""
    return shown.features if isinstance(shown, FeatureSet) else shown.image


def state_of(shown: Decoded) -> str:
    """Of features, which are never made up: `whole` or `missing`."""
    if isinstance(shown, FeatureSet):
        return "missing" if shown.features is None else "whole"
    return shown.state


def whole(where: str, decoded: Sequence[Decoded]) -> dict[int, Any]:
    """The contents by frame. Fails where one is not whole or comes twice."""
    contents: dict[int, Any] = {}
    for shown in decoded:
        if type(shown) not in (Picture, FeatureSet):
            raise ConformanceFailure(where, type(shown).__name__, "a Picture or a FeatureSet")
        content = content_of(shown)
        if state_of(shown) != "whole" or content is None:
            raise ConformanceFailure(where, f"frame {shown.frame} is {state_of(shown)}", "whole: nothing was lost")
        if isinstance(shown, FeatureSet) and type(content) is not Features:
            raise ConformanceFailure(where, type(content).__name__, "Features")
        if shown.frame in contents:
            raise ConformanceFailure(where, f"frame {shown.frame} twice", "each frame once")
        contents[shown.frame] = content
    return contents


def require_same_packets(where: str, got: Sequence[Packet], expected: Sequence[Packet]) -> None:
    """Fail unless two sessions gave the same packets."""
    if len(got) != len(expected):
        raise ConformanceFailure(where, f"{len(got)} packets", f"{len(expected)}")
    for index, (left, right) in enumerate(zip(got, expected, strict=True)):
        if left != right:
            what = "other bytes" if left.data != right.data else f"frame {left.frame}, starts={left.starts}"
            raise ConformanceFailure(f"{where}, packet {index}", what, "the same packet")


def require_same(where: str, got: Any, expected: Any) -> None:
    """Fail unless two images, or two sets of features in order, are the same to the bit."""
    if isinstance(expected, Features):
        _require_same_features(where, got, expected)
        return
    if got.shape != expected.shape:
        raise ConformanceFailure(where, f"shape {got.shape}", f"shape {expected.shape}")
    if not np.array_equal(got, expected):
        place = tuple(int(i) for i in np.argwhere(got != expected)[0])
        count = int(np.count_nonzero(got != expected))
        raise ConformanceFailure(where, f"{got[place]} at {place}, {count} samples differ", f"{expected[place]} there")


def _require_same_features(where: str, got: Features, expected: Features) -> None:
    if got.size != expected.size or len(got) != len(expected):
        counts = [f"{len(one)} features of {one.size[0]}x{one.size[1]}" for one in (got, expected)]
        raise ConformanceFailure(where, *counts)
    for name in FEATURE_ARRAYS:
        if not np.array_equal(getattr(got, name), getattr(expected, name), equal_nan=name != "descriptors"):
            raise ConformanceFailure(where, f"other {name}", "the same features")


def require_same_contents(where: str, got: Sequence[Decoded], expected: Sequence[Decoded], first: int = 0) -> None:
    """Fail unless two sessions gave the same, whole, from frame `first` on."""
    contents = whole(where, [shown for shown in got if type(shown.frame) is int and shown.frame >= first])
    others = {frame: content for frame, content in whole(where, expected).items() if frame >= first}
    if sorted(contents) != sorted(others):
        raise ConformanceFailure(where, f"the frames {sorted(contents)}", f"{sorted(others)}")
    for frame, content in contents.items():
        require_same(f"{where}, frame {frame}", content, others[frame])


def elsewhere(
    verb: Verb,
    where: str,
    function: Callable[..., Any],
    *arguments: Any,
    expected: str = "what this process gets",
    timeout_s: float = _TIMEOUT_S,
    memory_mb: int = _MEMORY_MB,
) -> Any:
    """What a function gives in another process. Fails where it gives nothing."""
    reply = sandbox(verb).call(function, *arguments, timeout_s=timeout_s, memory_mb=memory_mb)
    if reply.status != "done":
        raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", expected)
    return reply.value
