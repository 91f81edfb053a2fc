"""Checks of what a decoder makes of a bitstream of which parts are missing, as they are over a link."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Final

import numpy as np

from codecbench.core.conformance.failure import ConformanceFailure, NotClaimed
from codecbench.core.conformance.images import NamedImage
from codecbench.core.conformance.round_trip import CodecClass, encoded, require_equal
from codecbench.core.conformance.sandbox import sandbox
from codecbench.core.contracts.codec import Fragment, PartialImage
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Params

_TIMEOUT_S: Final = 20.0
_MEMORY_MB: Final = 1024
_PARTS: Final = 12
"""Into which a bitstream is cut, some of which are then missing."""
_TRIALS: Final = 20
_LOSS: Final = 0.25


def parts_decode(codec_class: CodecClass, params: Params, images: Sequence[NamedImage]) -> None:
    """What is there of a bitstream is refused, or gives a picture of the right shape that says truly what is whole."""
    if not codec_class.capabilities.partial_decoding:
        raise NotClaimed("this codec does not claim to decode parts of a bitstream")
    codec, rng = codec_class(params), np.random.default_rng(13)
    for image, bitstream in encoded(codec, images):
        decoded = codec.decode(bitstream)
        found = codec.decode_partial([Fragment(0, bitstream)])
        where = f"decode_partial({image.name}), nothing missing"
        _require_truth(where, found, decoded)
        if not found.whole.all():
            raise ConformanceFailure(where, f"{np.count_nonzero(~found.whole)} pixels not whole", "all whole")
        for trial in range(_TRIALS):
            fragments = _with_gaps(bitstream, rng)
            where = f"decode_partial({image.name}), {[(part.offset, part.end) for part in fragments]}, trial {trial}"
            reply = sandbox("decode").ask(
                codec_class, params, "decode_partial", fragments, timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB
            )
            if reply.status == "refused":
                continue
            if reply.status != "done":
                raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", "BitstreamError or a picture")
            _require_truth(where, reply.value, decoded)


def _with_gaps(bitstream: bytes, rng: np.random.Generator) -> list[Fragment]:
    """The first part, and others at random: with gaps in between, and in half of all trials an end that is missing."""
    bounds = [*np.linspace(0, len(bitstream), min(_PARTS, len(bitstream)) + 1, dtype=int).tolist()]
    there = rng.random(len(bounds) - 1) >= _LOSS
    there[0], there[-1] = True, rng.random() < 0.5
    fragments: list[Fragment] = []
    for (begin, end), is_there in zip(pairwise(bounds), there, strict=True):
        if not is_there:
            continue
        if fragments and fragments[-1].end == begin:
            begin = fragments.pop().offset
        fragments.append(Fragment(begin, bitstream[begin:end]))
    return fragments


def _require_truth(where: str, found: PartialImage, decoded: Image) -> None:
    """Fail unless a partial image has the shape of the whole one, and its pixels wherever it says so."""
    if not isinstance(found, PartialImage):
        raise ConformanceFailure(where, type(found).__name__, "a PartialImage")
    image, whole = found.image, found.whole
    if image.dtype != np.uint8 or image.shape != decoded.shape:
        raise ConformanceFailure(where, f"{image.dtype} of shape {image.shape}", f"uint8 of shape {decoded.shape}")
    if whole.dtype != np.bool_ or whole.shape != decoded.shape[:2]:
        raise ConformanceFailure(where, f"whole: {whole.dtype} of {whole.shape}", f"bool of {decoded.shape[:2]}")
    require_equal(f"{where}, where it claims to be whole", image[whole], decoded[whole])
