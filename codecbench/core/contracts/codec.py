"""The codec contract. One class a codec; an instance is one setting.

A `Codec` codes pictures one by one, stateless and silent about time and quality: others measure. Its bitstream is
self-contained: `decode` gets bytes and nothing else, so no table, shape or quality may reach the decoder
outside the bytes that are counted. Codecs with memory between frames are in `stream`, those of
features in `features`; `AnyCodec` is what all are.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Configured, P
from codecbench.core.counting.trace import NULL_TRACE, Trace

Reference = Literal["", "baseline", "anchor"]


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
    """What codecs of pictures, of streams and of features have in common.

    Class attributes: `name` as used in a matrix; `version`, raised whenever bitstreams or decoded pixels
    change, so that stored cells are recomputed; `params_type`; `capabilities`; `examples`, parameters of the
    settings on which the conformance kit and the benchmarks exercise this codec; `reference`, what it is to
    others: the `baseline` that a task without compression is judged by, or the `anchor` of BD-rates; `kernels`, the
    packages and modules whose listed kernels it calls, which a run compiles ahead; a setting that calls fewer has its
    own.
    """

    capabilities: ClassVar[Capabilities]
    examples: ClassVar[tuple[dict[str, Any], ...]] = ({},)
    kernels: tuple[str, ...] = ()
    reference: ClassVar[Reference] = ""

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


class Codec(AnyCodec[P]):
    """Base class of codecs that code each picture on its own."""

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

    def decode_partial(self, fragments: Sequence[Fragment], *, trace: Trace = NULL_TRACE) -> PartialImage:
        """The image of a bitstream as far as the fragments of it go; for codecs with `capabilities.partial_decoding`.

        fragments: one or more, undamaged, in order and with a gap before each but the first; how much is missing after
        the last is not known. A whole bitstream, as one fragment, gives what `decode` gives. Raises BitstreamError
        where nothing can be made of them, which for a setting may be whenever anything is missing.
        """
        raise Unsupported(f"{self.name} decodes nothing of a bitstream of which parts are missing")

    def prepared(self, image: Image) -> Self:
        """This setting with all found that `encode` would search for on this image: the rate that reaches a size, say.

        `codec.prepared(image).encode(image)` gives the bytes of `codec.encode(image)` by one encoding, which is what
        is timed. It is for that image alone; this instance stays as it is. A codec that searches for nothing returns
        itself. Raises what `encode` raises.
        """
        return self
