"""Closed formulas for the operations of JPEG, JPEG 2000 and the multi-level method, as the paper counts them.

Salih and Vasarhelyi, "End-to-End Multi-Level Encoding Methods of Visual Data Compression for Robust Monocular
Visual ORB-SLAM", Tables 4, 5 and 6, print numbers for one 640x480 plane and no formulas. Those here follow
from the numbers and reproduce each of them. The paper's conventions are kept although they contradict each
other: one 8-point product stands for a whole 8x8 transform, its additions are 112 a block for JPEG and 56
for the multi-level method, and five tests a coefficient stand for the search. The one choice of ours concerns
planes whose sides are no multiple of 8, 16 or 64: partial blocks count as blocks.
"""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from scipy.fft import dctn

from codecbench.core.contracts.image import Image, channel_count, gray_from_image
from codecbench.core.counting.operations import OperationCounts

Stages = dict[str, OperationCounts]
"""Operations by stage, in the order in which the stages run."""

PAPER_NONZERO_SHARE = 0.2
"""The share of quantised coefficients that the paper assumes to be nonzero; on real frames it is 0.04 to 0.09."""

_DWT_LEVELS = 5
_CODE_BLOCK_SIDE = 64


@dataclass(frozen=True)
class Plane:
    """A plane of samples."""

    width: int
    height: int

    @property
    def samples(self) -> int:
        """N of the formulas."""
        return self.width * self.height

    def blocks(self, side: int) -> int:
        """Square blocks of `side` that cover the plane: B for 8, and P / 4096 for 64."""
        return -(-self.width // side) * -(-self.height // side)

    @property
    def subband_samples(self) -> int:
        """S: samples that all levels of the wavelet transform process."""
        return sum(-(-self.width // 2**level) * -(-self.height // 2**level) for level in range(_DWT_LEVELS))


def _counts(
    mults: int, adds: int, bit_ops: int, comparisons: int, shifts: int, reads: int, writes: int
) -> OperationCounts:
    return OperationCounts(mults, adds, bit_ops, comparisons, shifts, reads, writes)


def _times(n: int, *weights: int) -> OperationCounts:
    return _counts(*(weight * n for weight in weights))


def _dc_shift(plane: Plane) -> OperationCounts:
    return _times(plane.samples, 0, 1, 0, 0, 0, 1, 1)


def jpeg_encoding(plane: Plane, nonzero_share: float = PAPER_NONZERO_SHARE) -> Stages:
    """Table 4, upper half. `nonzero_share`: of the quantised coefficients, 0 to 1."""
    n, z = plane.samples, nonzero_share * plane.samples
    return {
        "dc_shift": _dc_shift(plane),
        "dct": _counts(n, 112 * plane.blocks(8), 0, 0, 0, n, n),
        "quantization": _times(n, 1, 0, 1, 0, 1, 1, 1),
        "huffman_coding": _counts(0, 0, round(n + 1.5 * z), round(n + 0.5 * z), round(z), n, round(z)),
    }


def jpeg_decoding(plane: Plane, nonzero_share: float = PAPER_NONZERO_SHARE) -> Stages:
    """Table 4, lower half."""
    n, z = plane.samples, nonzero_share * plane.samples
    return {
        "huffman_decoding": _counts(0, 0, round(1.5 * z), round(z), round(z), round(z), n),
        "dequantization": _times(n, 1, 0, 1, 0, 1, 1, 1),
        "idct": _counts(n, 112 * plane.blocks(8), 0, 0, 0, n, n),
        "inverse_dc_shift": _dc_shift(plane),
    }


def jpeg2000_encoding(plane: Plane) -> Stages:
    """Table 5, upper half: five levels of the 9/7 wavelet, code blocks of 64x64."""
    n, code_samples = plane.samples, _CODE_BLOCK_SIDE**2 * plane.blocks(_CODE_BLOCK_SIDE)
    return {
        "dc_shift": _dc_shift(plane),
        "dwt": _times(plane.subband_samples, 20, 16, 0, 0, 8, 8, 4),
        "quantization": _times(n, 1, 0, 0, 1, 1, 1, 1),
        "tier1_coding": _times(code_samples, 0, 0, 12, 9, 0, 4, 2),
        "tier2_coding": _times(n, 2, 2, 10, 0, 0, 2, 1),
    }


def jpeg2000_decoding(plane: Plane) -> Stages:
    """Table 5, lower half."""
    n, code_samples = plane.samples, _CODE_BLOCK_SIDE**2 * plane.blocks(_CODE_BLOCK_SIDE)
    return {
        "tier2_decoding": _times(n, 0, 1, 6, 0, 0, 1, 1),
        "tier1_decoding": _times(code_samples, 0, 0, 8, 3, 0, 2, 1),
        "dequantization": _times(n, 1, 0, 0, 0, 1, 1, 1),
        "idwt": _times(plane.subband_samples, 16, 12, 0, 0, 4, 4, 4),
        "inverse_dc_shift": _dc_shift(plane),
    }


def _symbols(plane: Plane, levels: int, group: int) -> list[int]:
    """The number of symbols before the first level, after it, and so on."""
    counts = [plane.samples]
    for _ in range(levels):
        counts.append(-(-counts[-1] // group))
    return counts


def _level_name(stage: str, level: int) -> str:
    return stage if level == 1 else f"{stage}_{level}"


def multilevel_encoding(plane: Plane, levels: int = 1, group: int = 3) -> Stages:
    """Table 6, upper half. The paper does not count levels above the first; they are taken to cost the same."""
    n, symbols = plane.samples, _symbols(plane, levels, group)
    stages = {
        "dct": _counts(n, 56 * plane.blocks(8), n, plane.blocks(8), 0, n, n),
        "quantization": _counts(n, 0, n, 0, 0, n + 64, n),
    }
    for level in range(1, levels + 1):
        before, after = symbols[level - 1], symbols[level]
        stages[_level_name("minimization", level)] = _counts(before, before - after, after, before, 0, before, after)
    return stages | {"arithmetic_coding": _times(symbols[-1], 0, 1, 8, 1, 8, 1, 1)}


def multilevel_decoding(plane: Plane, levels: int = 1, group: int = 3, search: bool = True) -> Stages:
    """Table 6, lower half, which is decoding by search.

    The paper calls decoding with the header (`search` false) instant and does not count it. Our formula for it takes
    each symbol to cost a read of itself and a copy of its digits.
    """
    n, symbols = plane.samples, _symbols(plane, levels, group)
    stages = {"arithmetic_decoding": _times(symbols[-1], 0, 1, 8, 1, 8, 1, 1)}
    for level in range(levels, 0, -1):
        before, after = symbols[level - 1], symbols[level]
        if search:
            stages[_level_name("sequential_search", level)] = _times(before, 5, 5, 1, 5, 0, 5, 1)
        else:
            stages[_level_name("header_lookup", level)] = _counts(0, 0, 0, 0, 0, before + after, before)
    return stages | {
        "dequantization": _counts(n, 0, n, plane.blocks(8), 0, n + 64, n),
        "idct": _counts(n, 56 * plane.blocks(8), 8 * plane.blocks(8), plane.blocks(8), 0, n, n),
    }


_CHROMA_DIVISORS = {"422": (2, 1), "420": (2, 2), "ycbcr420": (2, 2)}
"""Horizontal and vertical subsampling factors of chroma, for formats that have any."""

_JPEGS = ("jpeg", "jpeg_qf")


def has_model(codec: str, params: dict[str, Any]) -> bool:
    """Whether the paper has formulas for this setting; it has none for the reversible wavelet."""
    return codec in (*_JPEGS, "multilevel") or (codec == "jpeg2000" and bool(params.get("irreversible", True)))


def coded_planes(image: Image, params: dict[str, Any]) -> list[Plane]:
    """The planes of an image that a codec with these parameters codes."""
    height, width = image.shape[:2]
    sampling = str(params.get("color") or params.get("subsampling") or "444")
    if channel_count(image) == 1 or sampling == "gray":
        return [Plane(width, height)]
    across, down = _CHROMA_DIVISORS.get(sampling, (1, 1))
    chroma = Plane(-(-width // across), -(-height // down))
    return [Plane(width, height), chroma, chroma]


def model_stages(
    codec: str, params: dict[str, Any], planes: list[Plane], nonzero_share: float
) -> tuple[Stages, Stages]:
    """Encoding and decoding stages of a codec for which `has_model` is true, summed over planes."""
    encoding, decoding = zip(*(_plane_model(codec, params, plane, nonzero_share) for plane in planes), strict=True)
    return _sum_planes(encoding), _sum_planes(decoding)


def _sum_planes(stages: tuple[Stages, ...]) -> Stages:
    return {name: OperationCounts.sum(plane[name] for plane in stages) for name in stages[0]}


def _plane_model(codec: str, params: dict[str, Any], plane: Plane, nonzero_share: float) -> tuple[Stages, Stages]:
    if codec in _JPEGS:
        return jpeg_encoding(plane, nonzero_share), jpeg_decoding(plane, nonzero_share)
    if codec == "jpeg2000":
        return jpeg2000_encoding(plane), jpeg2000_decoding(plane)
    levels, group = int(params.get("levels", 1)), int(params.get("group", 3))
    search = params.get("decoding") == "search"
    return (
        multilevel_encoding(plane, levels, group),
        multilevel_decoding(plane, levels, group, search),
    )


def measure_nonzero_share(image: Image, bitstream: bytes) -> float:
    """Share of the luma coefficients that are nonzero after quantisation by the steps of a JPEG file."""
    steps = np.array(PillowImage.open(io.BytesIO(bitstream)).quantization[0], dtype=np.float64)  # type: ignore[attr-defined]
    return nonzero_share(gray_from_image(image), steps.reshape(8, 8))


def nonzero_share(gray: Image, steps: NDArray[np.float64]) -> float:
    """Share of round(C / steps) that is nonzero, for the 8x8 DCT of a (H, W) plane minus 128. steps: (8, 8)."""
    height, width = gray.shape
    padded = np.pad(gray.astype(np.float64) - 128.0, ((0, -height % 8), (0, -width % 8)), mode="edge")
    blocks = padded.reshape(padded.shape[0] // 8, 8, -1, 8).swapaxes(1, 2)
    coefficients = dctn(blocks, axes=(2, 3), norm="ortho")
    return float(np.mean(np.abs(coefficients / steps) >= 0.5))
