"""Which formulas stand for which codec: by the names and parameters of those that ship."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from scipy.fft import dctn

from codecbench.core.contracts.image import Image, channel_count, gray_from_image
from codecbench.core.counting.operations import OperationCounts
from codecbench.plugins.evaluators.operations import model
from codecbench.plugins.evaluators.operations.model import Plane, Stages

_CHROMA_DIVISORS = {"422": (2, 1), "420": (2, 2), "ycbcr420": (2, 2)}
"""By how much a chroma plane is narrower and lower than luma, where it is."""

_JPEGS = ("jpeg", "jpeg_qf")


def has_model(codec: str, params: dict[str, Any]) -> bool:
    """Whether the paper's formulas stand for this setting; they know no reversible wavelet."""
    return codec in (*_JPEGS, "multilevel") or (codec == "jpeg2000" and bool(params.get("irreversible", True)))


def coded_planes(image: Image, params: dict[str, Any]) -> list[Plane]:
    """The planes that a codec with these parameters codes of an image."""
    height, width = image.shape[:2]
    sampling = str(params.get("color") or params.get("subsampling") or "444")
    if channel_count(image) == 1 or sampling == "gray":
        return [Plane(width, height)]
    across, down = _CHROMA_DIVISORS.get(sampling, (1, 1))
    chroma = Plane(-(-width // across), -(-height // down))
    return [Plane(width, height), chroma, chroma]


def modelled(codec: str, params: dict[str, Any], planes: list[Plane], nonzero_share: float) -> tuple[Stages, Stages]:
    """Encoding and decoding stages of a codec that `has_model`, summed over planes."""
    encoding, decoding = zip(*(_plane_model(codec, params, plane, nonzero_share) for plane in planes), strict=True)
    return _summed(encoding), _summed(decoding)


def _summed(stages: tuple[Stages, ...]) -> Stages:
    return {name: OperationCounts.sum(plane[name] for plane in stages) for name in stages[0]}


def _plane_model(codec: str, params: dict[str, Any], plane: Plane, nonzero_share: float) -> tuple[Stages, Stages]:
    if codec in _JPEGS:
        return model.jpeg_encoding(plane, nonzero_share), model.jpeg_decoding(plane, nonzero_share)
    if codec == "jpeg2000":
        return model.jpeg2000_encoding(plane), model.jpeg2000_decoding(plane)
    levels, group = int(params.get("levels", 1)), int(params.get("group", 3))
    search = params.get("decoding") == "search"
    return (
        model.multilevel_encoding(plane, levels, group),
        model.multilevel_decoding(plane, levels, group, search),
    )


def measured_nonzero_share(image: Image, bitstream: bytes) -> float:
    """Share of the luma coefficients that are nonzero once divided by the steps in a JPEG file."""
    steps = np.array(PillowImage.open(io.BytesIO(bitstream)).quantization[0], dtype=np.float64)  # type: ignore[attr-defined]
    return nonzero_share(gray_from_image(image), steps.reshape(8, 8))


def nonzero_share(gray: Image, steps: NDArray[np.float64]) -> float:
    """Share of round(C / steps) that is nonzero, for the 8x8 DCT of a (H, W) plane less 128. steps: (8, 8)."""
    height, width = gray.shape
    padded = np.pad(gray.astype(np.float64) - 128.0, ((0, -height % 8), (0, -width % 8)), mode="edge")
    blocks = padded.reshape(padded.shape[0] // 8, 8, -1, 8).swapaxes(1, 2)
    coefficients = dctn(blocks, axes=(2, 3), norm="ortho")
    return float(np.mean(np.abs(coefficients / steps) >= 0.5))
