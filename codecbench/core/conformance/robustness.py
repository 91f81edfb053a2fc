"""Checks of what a decoder does with bytes that no encoder wrote, in a process that may die of it.

Each stream has a time and a memory cap. Foreign and cut streams must be refused with BitstreamError; damaged
ones may decode to some image, because not every format has a checksum, but never crash, hang or raise.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from codecbench.core.conformance.failure import ConformanceFailure
from codecbench.core.conformance.images import NamedImage
from codecbench.core.conformance.round_trip import CodecClass, encoded
from codecbench.core.conformance.sandbox import Reply, sandbox
from codecbench.core.contracts.errors import ImageError
from codecbench.core.contracts.image import MAX_PIXELS, check_image
from codecbench.core.contracts.params import Params

_TIMEOUT_S = 20.0
_MEMORY_MB = 1024
_CUTS = 40
_MUTATIONS = 60
BOMBED_BYTES = 96
HUGE = (b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x00\x01\xff\xff", b"\xff\xff\x01\x00", b"\xff\xff\xff\x7f")
FOREIGN = {
    "no bytes": b"",
    "one byte": b"\x00",
    "zeros": bytes(200),
    "ones": b"\xff" * 200,
    "text": b"What a codec is given may be anything, a letter too.\n" * 4,
    "a PNG signature": b"\x89PNG\r\n\x1a\n" + bytes(40),
    "a JPEG start and end": b"\xff\xd8\xff\xd9",
    "a JPEG 2000 signature": b"\x00\x00\x00\x0cjP  \r\n\x87\n" + bytes(40),
    "a RIFF header": b"RIFF\x28\x00\x00\x00WEBPVP8 " + bytes(40),
}


def _decode(codec_class: CodecClass, params: Params, stream: bytes) -> Reply:
    return sandbox("decode").ask(codec_class, params, "decode", stream, timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB)


def _must_survive(codec_class: CodecClass, params: Params, streams: Iterable[tuple[str, bytes]]) -> None:
    """Every stream is refused or gives a uint8 image of a sane size."""
    for where, stream in streams:
        reply = _decode(codec_class, params, stream)
        if reply.status not in ("done", "refused"):
            raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", "BitstreamError or an image")
        if reply.status == "done":
            require_image(where, reply.value)


def require_image(where: str, pixels: Any) -> None:
    try:
        check_image(pixels)
    except ImageError as error:
        raise ConformanceFailure(where, str(error), "BitstreamError or an image") from error
    if pixels.shape[0] * pixels.shape[1] > MAX_PIXELS:
        raise ConformanceFailure(where, f"an image of shape {pixels.shape}", f"at most {MAX_PIXELS} pixels")


def _must_refuse(codec_class: CodecClass, params: Params, streams: Iterable[tuple[str, bytes]]) -> None:
    for where, stream in streams:
        reply = _decode(codec_class, params, stream)
        if reply.status != "refused":
            got = (
                f"an image of shape {reply.value.shape}"
                if reply.status == "done"
                else f"{reply.status}: {reply.reason}"
            )
            raise ConformanceFailure(where, got, "BitstreamError")


def _samples(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> list[tuple[str, bytes]]:
    """Two bitstreams to damage: of the largest and of the smallest image that the codec takes."""
    streams = [(image.name, bitstream) for image, bitstream in encoded(codec_class(params), images)]
    longest = max(streams, key=lambda stream: len(stream[1]))
    return list(dict([longest, min(streams, key=lambda stream: len(stream[1]))]).items())


def foreign_bytes_are_refused(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    noise = np.random.default_rng(7).integers(0, 256, 3000, dtype=np.uint8).tobytes()
    foreign = {**FOREIGN, "noise": noise}
    _must_refuse(codec_class, params, ((f"decode({name})", stream) for name, stream in foreign.items()))


def cut_streams_are_refused(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    for name, stream in _samples(codec_class, params, images):
        lengths = sorted({*np.linspace(0, len(stream) - 1, _CUTS, dtype=int).tolist(), len(stream) - 1})
        cuts = ((f"decode({name}), {length} of {len(stream)} bytes", stream[:length]) for length in lengths)
        _must_refuse(codec_class, params, cuts)
        _must_refuse(codec_class, params, [(f"decode({name}) with a byte added", stream + b"\0")])


def damaged_streams_are_survived(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    rng = np.random.default_rng(11)
    for name, stream in _samples(codec_class, params, images):
        _must_survive(codec_class, params, mutations(stream, rng, _MUTATIONS, name))


def huge_headers_are_survived(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    """Every place of the header in turn claims as much as it can, within the time and memory caps."""
    for name, stream in _samples(codec_class, params, images)[-1:]:
        bombs = (
            (f"decode({name}), {huge.hex()} at byte {place}", stream[:place] + huge + stream[place + len(huge) :])
            for place in range(min(BOMBED_BYTES, len(stream) - 4))
            for huge in HUGE
        )
        _must_survive(codec_class, params, bombs)


def mutations(stream: bytes, rng: np.random.Generator, count: int, name: str) -> Iterator[tuple[str, bytes]]:
    """Copies of a stream with bits flipped, bytes changed, parts overwritten, taken out or repeated."""
    for index in range(count):
        mutant = bytearray(stream)
        place = int(rng.integers(len(stream)))
        kind = index % 5
        if kind == 0:
            mutant[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            for _ in range(int(rng.integers(1, 8))):
                mutant[int(rng.integers(len(stream)))] = int(rng.integers(256))
        elif kind == 2:
            part = mutant[place : place + int(rng.integers(1, 20))]
            mutant[place : place + len(part)] = rng.integers(0, 256, len(part), dtype=np.uint8).tobytes()
        elif kind == 3:
            del mutant[place : place + int(rng.integers(1, 30))]
        else:
            mutant[place:place] = mutant[: int(rng.integers(1, 30))]
        yield f"decode({name}), mutation {index} at byte {place}", bytes(mutant)
