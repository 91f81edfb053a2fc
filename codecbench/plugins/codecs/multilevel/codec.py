"""The multi-level codec: from image to bitstream and back."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.codec import Capabilities, Codec, Fragment, PartialImage
from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import Image, check_image
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.dct.blocks import blocks_from_plane, plane_from_blocks
from codecbench.plugins.codecs.dct.planes import (
    Color,
    crop_plane,
    dct_kernels,
    image_from_planes,
    pad_plane,
    planes_from_image,
)
from codecbench.plugins.codecs.dct.tables import steps_from_table
from codecbench.plugins.codecs.multilevel import entropy_coding
from codecbench.plugins.codecs.multilevel.bitstream import Bitstream, pack, unpack, version_of
from codecbench.plugins.codecs.multilevel.context import bitstream as context
from codecbench.plugins.codecs.multilevel.context import profile
from codecbench.plugins.codecs.multilevel.context.bitstream import CHROMA_UNITS, ContextHeader
from codecbench.plugins.codecs.multilevel.header import CONTEXT_VERSION, MAX_SAMPLES, TABLES, Header, Picture
from codecbench.plugins.codecs.multilevel.keys import canonical_keys, check_keys, manual_keys, random_keys
from codecbench.plugins.codecs.multilevel.levels import (
    KeyMaker,
    expand_levels,
    minimize_levels,
    scan_blocks,
    unscan_blocks,
)
from codecbench.plugins.codecs.multilevel.params import MultilevelParams

_HERE = "codecbench.plugins.codecs.multilevel"
_CONTEXT_KERNELS = ("codecbench.plugins.codecs.dct.color", "codecbench.plugins.codecs.dct.planes", f"{_HERE}.context")


def static_kernels(params: MultilevelParams) -> tuple[str, ...]:
    """Kernels that parameters of the profile `static` need."""
    names = ["arithmetic", "minimize"]
    if params.scan == "coefficient":
        names += ["levels"]
    if params.decoding == "search":
        names += ["tables.encode_codes", "tables.decode_codes", "keys"]
    else:
        names += ["rice"] if params.effort == "fast" else ["tables.encode_tuples", "tables.decode_tuples"]
    return *dct_kernels(params.color), *(f"{_HERE}.{name}" for name in names)


class Multilevel(Codec[MultilevelParams]):
    """Multi-level minimisation of quantised DCT coefficients with order-0 arithmetic coding.

    Source: Salih & Vasarhelyi, End-to-End Multi-Level Encoding Methods of Visual Data Compression for Robust
    Monocular Visual ORB-SLAM. docs/multilevel.md specifies what the paper leaves open.
    """

    name: ClassVar[str] = "multilevel"
    version: ClassVar[str] = "1"
    params_type = MultilevelParams
    capabilities: ClassVar[Capabilities] = Capabilities(counts_operations=True, partial_decoding=True)
    kernels: tuple[str, ...] = ("codecbench.plugins.codecs.dct", _HERE)
    examples = (
        {},
        {"qf": 20, "levels": 2, "decoding": "search", "color": "ycbcr420"},
        {"qf": 75, "keys": "random", "seed": 3, "scan": "coefficient", "table": "standard", "color": "ycbcr444"},
        {"qf": 10, "group": 2, "table": "flat", "color": "gray"},
        {"qf": 5, "effort": "fast"},
        {"qf": 2, "profile": "context"},
        {"qf": 0.1, "profile": "context", "effort": "fast", "color": "rgb", "restart": 1},
        {"qf": 3, "profile": "context", "effort": "normal", "color": "ycbcr444", "table": "standard", "lapped": True},
    )

    def __init__(self, params: MultilevelParams) -> None:
        super().__init__(params)
        self.kernels = _CONTEXT_KERNELS if params.profile == "context" else static_kernels(params)

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        """Encode one image; a gray image is coded as one plane for every `color`.

        Raises KeyCollision if manual keys give two tuples the same code, ParamsError if codes would not fit 62 bits,
        ImageError for images of too many pixels or too many different tuples.
        """
        image = check_image(image)
        if self.params.profile == "context":
            context = self._context_header(self._picture(image))
            return profile.encode(image, context, self.params.effort, trace, threads=self.params.threads)
        header = self.header_of(image)
        values = self.values_of(image, header, trace)
        minimized = minimize_levels(values, self.params.levels, self._key_maker(), trace)
        return pack(entropy_coding.encode(header, minimized, trace))

    def header_of(self, image: Image) -> Header:
        """Return the header of an image's bitstream without offset and radix. Raises ImageError for too many pixels."""
        params = self.params
        return Header(
            **vars(self._picture(image)),
            levels=params.levels,
            group=params.group,
            search=params.decoding == "search",
            coefficient_scan=params.scan == "coefficient",
            offset=0,
            radix=1,
            rice=params.effort == "fast",
        )

    def values_of(self, image: Image, header: Header, trace: Trace) -> NDArray[np.int32]:
        """Quantized coefficients (n,) of all planes, in the order of minimization."""
        return scan_blocks(self._blocks(image, header, trace), self.params.scan, trace)

    def _picture(self, image: Image) -> Picture:
        """Header fields of both profiles. Raises ImageError for too many pixels."""
        chosen = self.params.table
        picture = Picture(
            width=image.shape[1],
            height=image.shape[0],
            channels=1 if image.ndim == 2 else 3,
            color=self.params.color if image.ndim == 3 else "gray",
            qf=self.params.qf,
            table=TABLES[chosen][1] if isinstance(chosen, str) else np.array(chosen, np.int32).reshape(8, 8),
        )
        if picture.samples > MAX_SAMPLES:
            raise ImageError(f"image of shape {image.shape} needs {picture.samples} samples; allowed: {MAX_SAMPLES}")
        return picture

    def _context_header(self, picture: Picture) -> ContextHeader:
        params = self.params
        return ContextHeader(
            **vars(picture),
            lapped=params.lapped,
            mixing=params.effort != "fast",
            chroma=round(params.chroma * CHROMA_UNITS),
            restart=params.restart,
            biases=np.zeros((len(picture.plane_shapes), 3, 3), np.int32),
        )

    def _blocks(self, image: Image, header: Header, trace: Trace) -> NDArray[np.int32]:
        """Quantized blocks (b, 64) of all planes, in zigzag order."""
        steps = steps_from_table(header.table, header.qf)
        blocks = np.empty((header.samples // 64, 64), np.int32)
        start = 0
        for number, plane in enumerate(planes_from_image(image, header.color, trace)):
            plane = pad_plane(plane, trace=trace)
            out = blocks[start : start + plane.size // 64]
            blocks_from_plane(plane, steps, _level_shift(header.color, number), out=out, trace=trace)
            start += len(out)
        return blocks

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        """Decode a bitstream; of this instance's parameters only `search` and `threads` matter, for speed.

        Raises BitstreamError for damaged or foreign bytes, ParamsError if `search: sequential` would take too long.
        """
        if version_of(bitstream) == CONTEXT_VERSION:
            return profile.decode(bitstream, trace, threads=self.params.threads)
        parts: Bitstream = unpack(bitstream)
        header = parts.header
        ranks, tuples = entropy_coding.decode(parts, self.params.search, trace)
        del parts
        values = expand_levels(ranks, tuples, header.offset, header.samples, trace)
        del ranks, tuples
        return image_from_values(values, header, trace)

    def decode_partial(self, fragments: Sequence[Fragment], *, trace: Trace = NULL_TRACE) -> PartialImage:
        """Decode the complete slices, with gray for the others; needs `restart`."""
        if len(fragments) == 1 and fragments[0].offset == 0:
            with suppress(BitstreamError):
                return PartialImage.of_whole(self.decode(fragments[0].data, trace=trace))
        bitstream = bytearray(fragments[-1].end)
        for fragment in fragments:
            bitstream[fragment.offset : fragment.end] = fragment.data
        partial = profile.salvage(bytes(bitstream))
        whole = np.ones(partial.image.shape[:2], dtype=bool)
        for rows in partial.lost:
            whole[max(rows.start - profile.REACH_ROWS, 0) : rows.stop + profile.REACH_ROWS] = False
        if not whole.any():
            raise BitstreamError("multilevel: no slice is complete")
        return PartialImage(partial.image, whole)

    def _key_maker(self) -> KeyMaker:
        keys, group = self.params.keys, self.params.group
        if keys == "canonical":
            return lambda level, radix: check_keys(canonical_keys(radix, group), radix, level)
        if keys == "random":
            rng = np.random.default_rng(self.params.seed)
            return lambda level, radix: check_keys(random_keys(radix, group, rng), radix, level)
        return lambda level, radix: check_keys(manual_keys(keys), radix, level)


def _level_shift(color: Color, plane: int) -> float:
    """Level shift: 128 for chroma, none for luma, RGB and gray."""
    return 128.0 if color.startswith("ycbcr") and plane > 0 else 0.0


def image_from_values(values: NDArray[np.int32], header: Header, trace: Trace) -> Image:
    """Reconstruct an image from quantized coefficients (n,) in the order of minimization."""
    blocks = unscan_blocks(values, "coefficient" if header.coefficient_scan else "block", trace)
    steps = steps_from_table(header.table, header.qf)
    planes = []
    start = 0
    for number, (shape, padded_shape) in enumerate(zip(header.plane_shapes, header.padded_shapes, strict=True)):
        stop = start + padded_shape[0] * padded_shape[1] // 64
        shift = _level_shift(header.color, number)
        plane = plane_from_blocks(blocks[start:stop], padded_shape, steps, shift, trace=trace)
        planes.append(crop_plane(plane, shape, trace))
        start = stop
    return image_from_planes(planes, header.color, header.channels, trace)


@dataclass(frozen=True)
class Sizes:
    """Sizes in bytes of a bitstream's parts."""

    header: int
    """Fixed fields, custom table, section sizes and checksum."""
    tables: tuple[int, ...]
    """By level."""
    keys: tuple[int, ...]
    """By level."""
    payload: int
    entries: tuple[int, ...]
    """Number of table entries by level."""

    @property
    def total(self) -> int:
        return self.header + sum(self.tables) + sum(self.keys) + self.payload


def describe(bitstream: bytes) -> Sizes:
    """Measure the parts of a bitstream of either profile. Raises BitstreamError as decoding would."""
    if version_of(bitstream) == CONTEXT_VERSION:
        payload = sum(map(len, context.unpack(bitstream)[1]))
        return Sizes(len(bitstream) - payload, (), (), payload, ())
    parts = unpack(bitstream)
    tables = tuple(len(level.table) for level in parts.levels)
    keys = tuple(level.keys.nbytes for level in parts.levels)
    header = len(bitstream) - sum(tables) - sum(keys) - len(parts.payload)
    return Sizes(header, tables, keys, len(parts.payload), tuple(level.entries for level in parts.levels))
