"""Baseline JPEG (ITU-T T.81) from instrumented kernels, with a real factor on the quantization table.

The factor multiplies the whole table, as in Salih & Vasarhelyi: q = round(C / (M qf)). A file holds whole steps only,
so M qf is rounded to 1..65535. The stages are those of `dct/` (the level shift of T.81 A.3.1 is part of the transform)
and `huffman`. The decoder enlarges chroma as libjpeg does, which all but defines how a JPEG looks.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.codec import Capabilities, Codec
from codecbench.core.contracts.errors import ImageError
from codecbench.core.contracts.image import Image, channel_count, check_image
from codecbench.core.contracts.params import Params
from codecbench.core.counting.kernel import kernel
from codecbench.core.counting.trace import NULL_TRACE, Run, Trace
from codecbench.plugins.codecs.dct import tables
from codecbench.plugins.codecs.dct.blocks import blocks_from_plane, plane_from_blocks
from codecbench.plugins.codecs.dct.color import double, rgb_from_ycbcr
from codecbench.plugins.codecs.dct.planes import crop_plane, dct_kernels, pad_plane, planes_from_image
from codecbench.plugins.codecs.jfif import MAX_SIDE, SOF_BASELINE, Component, FrameHeader
from codecbench.plugins.codecs.jpeg_qf.interchange import MAX_JPEG_QF_PIXELS, CodedPicture, read_file, write_file
from codecbench.plugins.codecs.jpeg_qf.scan import read_scan, scan_layout, write_scan

_SHIFT = 128.0
_MAX_STEP = 65535
_LUMA, _CHROMA = 0, 1
_TABLES = {
    "paper": (tables.PAPER, tables.with_unit_head(tables.CHROMINANCE)),
    "standard": (tables.LUMINANCE, tables.CHROMINANCE),
}

_NARROWEST_SMOOTHED = 3
"""Narrower planes, of one or two columns, are repeated, not interpolated."""


class JpegQfParams(Params):
    """Set the paper's factor, and what a JFIF file leaves open."""

    qf: float = Field(5.0, gt=0, le=1000, description="factor on the quantization table; the paper uses 5 to 100")
    table: Literal["paper", "standard"] = Field(
        "paper", description="T.81's K.1 and K.2 (standard), or these with 1 in their first six zigzag places (paper)"
    )
    color: Literal["gray", "ycbcr444", "ycbcr420"] = Field(
        "ycbcr444", description="planes of a color image; a gray image is always one plane"
    )
    optimize: bool = Field(
        False, description="compute Huffman tables for each image (T.81 K.2) instead of using the example tables"
    )


class JpegQf(Codec[JpegQfParams]):
    """The paper's JPEG as a JFIF file that any decoder reads."""

    name = "jpeg_qf"
    version = "1"
    params_type = JpegQfParams
    capabilities = Capabilities(counts_operations=True)
    kernels: tuple[str, ...] = ("codecbench.plugins.codecs.dct", "codecbench.plugins.codecs.jpeg_qf")
    examples = (
        {},
        {"qf": 100, "optimize": True, "color": "ycbcr420"},
        {"qf": 0.01, "table": "standard", "color": "ycbcr420"},
        {"qf": 20, "color": "gray"},
    )

    def __init__(self, params: JpegQfParams) -> None:
        super().__init__(params)
        self.kernels = (*dct_kernels(params.color), "codecbench.plugins.codecs.jpeg_qf")
        self._quantizers = [_steps(table, params.qf) for table in _TABLES[params.table]]

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image)
        header = self._header(image)
        layout = scan_layout(header)
        blocks = np.empty((len(layout.order), 64), np.int32)
        start = 0
        for plane, component in zip(planes_from_image(image, self.params.color, trace), header.components, strict=True):
            plane = pad_plane(plane, 8 * component.h, trace)
            out = blocks[start : start + plane.size // 64]
            blocks_from_plane(plane, _natural_order(self._quantizers[component.table]), _SHIFT, out=out, trace=trace)
            start += len(out)
        selectors = tuple((component.table, component.table) for component in header.components)
        huffman_tables, scan_data = write_scan(blocks, layout, selectors, self.params.optimize, trace)
        quantizers = {component.table: self._quantizers[component.table] for component in header.components}
        return write_file(CodedPicture(header, quantizers, huffman_tables, selectors, 0, scan_data))

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        picture = read_file(bitstream)
        header, layout = picture.header, scan_layout(picture.header)
        blocks = read_scan(picture, layout, trace)
        planes, first = [], 0
        for component, part, (rows, columns) in zip(header.components, _part_shapes(header), layout.grids, strict=True):
            last = first + rows * columns
            steps = _natural_order(picture.quantizers[component.table])
            plane = plane_from_blocks(blocks[first:last], (8 * rows, 8 * columns), steps, _SHIFT, trace=trace)
            planes.append(crop_plane(plane, part, trace))
            first = last
        if len(planes) == 1:
            return planes[0]
        luma = header.components[0]
        image: Image = np.empty(header.shape, np.uint8)
        with trace.stage("inverse_color_transform") as run:
            chroma = [upsample(plane, luma.h, luma.v, planes[0].shape, run) for plane in planes[1:]]
            run(rgb_from_ycbcr, planes[0], *chroma, image)
        return image

    def _header(self, image: Image) -> FrameHeader:
        height, width = image.shape[:2]
        if max(height, width) > MAX_SIDE or height * width > MAX_JPEG_QF_PIXELS:
            raise ImageError(f"jpeg_qf: {width}x{height} exceeds {MAX_SIDE} a side or {MAX_JPEG_QF_PIXELS} pixels")
        if channel_count(image) == 1 or self.params.color == "gray":
            return FrameHeader(SOF_BASELINE, width, height, (Component(1, 1, 1, _LUMA),))
        factor = 2 if self.params.color == "ycbcr420" else 1
        chroma = (Component(2, 1, 1, _CHROMA), Component(3, 1, 1, _CHROMA))
        return FrameHeader(SOF_BASELINE, width, height, (Component(1, factor, factor, _LUMA), *chroma))


def _steps(table: tables.Table, factor: float) -> NDArray[np.uint16]:
    """Whole quantization steps (64,) in zigzag order."""
    steps = np.clip(np.floor(table.astype(np.float64) * factor + 0.5), 1, _MAX_STEP)
    return steps.reshape(64)[tables.ZIGZAG].astype(np.uint16)


def _natural_order(steps: NDArray[np.uint16]) -> NDArray[np.float32]:
    natural = np.empty(64, np.float32)
    natural[tables.ZIGZAG] = steps
    return natural


def _part_shapes(header: FrameHeader) -> list[tuple[int, int]]:
    """(height, width) of the part of each component's plane that the image covers."""
    luma = header.components[0]
    if len(header.components) == 1:
        return [(header.height, header.width)]
    return [
        (-(-header.height * component.v // luma.v), -(-header.width * component.h // luma.h))
        for component in header.components
    ]


def upsample(plane: NDArray[np.uint8], h: int, v: int, shape: tuple[int, int], run: Run) -> NDArray[np.uint8]:
    """Enlarge a plane whose samples cover h x v pixels to `shape`, (height, width) of the image.

    (h, v) is (1, 1), (2, 1) or (2, 2).
    """
    if h == v == 1:
        return plane
    large = np.empty(shape, np.uint8)
    if plane.shape[1] < _NARROWEST_SMOOTHED:
        run(repeat, plane, h, v, large)
    else:
        run(double if v == 2 else widen, plane, large)
    return large


@kernel
def repeat(plane: Any, h: Any, v: Any, large: Any) -> None:
    """Repeat every sample h times across and v times down, as far as `large` goes."""
    for row in range(large.shape[0]):
        for column in range(large.shape[1]):
            large[row, column] = plane[row // v, column // h]


@kernel
def widen(plane: Any, large: Any) -> None:
    """Interpolate to twice the width: 3:1 means of the nearest two samples, halves down on even columns, else up.

    plane: (H, ceil W/2) uint8. large: (H, W) uint8, filled.
    """
    last = plane.shape[1] - 1
    for row in range(large.shape[0]):
        for column in range(large.shape[1]):
            odd = column & 1
            near = column >> 1
            far = min(max(near - 1 + 2 * odd, 0), last)
            large[row, column] = np.uint8((3 * np.int32(plane[row, near]) + np.int32(plane[row, far]) + 1 + odd) >> 2)
