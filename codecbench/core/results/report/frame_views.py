"""Frames side by side: the original, what a codec made of it, and where they differ."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from codecbench.core.contracts.evaluator import CodedFrame
from codecbench.core.contracts.image import Image, gray_from_image

CROP: Final = (360, 270)
"""Width and height of what is shown, at one screen pixel a picture pixel, so that artefacts look as they are."""

_WEBP_QUALITY: Final = 82
_FOUND_PX: Final = 3.0
"""A feature counts as kept where the decoded frame has one within this distance."""
_GAIN: Final = 4
"""Differences of gray are shown this many times stronger, around middle gray."""


@dataclass(frozen=True)
class FrameView:
    """Data URIs of the three pictures and how many of the original's features were lost."""

    original: str
    decoded: str
    difference: str
    features: int
    lost: int


def frame_view(coded: CodedFrame) -> FrameView:
    """The middle of a coded frame; circles on the difference mark features that the decoded frame no longer has."""
    original, decoded = (_middle(image) for image in (coded.original.image, coded.decoded))
    points, kept = _kept_features(original, decoded)
    difference = 128 + _GAIN * (gray_from_image(decoded).astype(np.int16) - gray_from_image(original))
    shown = np.repeat(np.clip(difference, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)
    for (x, y), found in zip(points, kept, strict=True):
        if not found:
            cv2.circle(shown, (round(float(x)), round(float(y))), 5, (230, 20, 20), 2, cv2.LINE_AA)
    return FrameView(_uri(original), _uri(decoded), _uri(shown), len(points), int((~kept).sum()))


def _middle(image: Image) -> Image:
    width, height = (min(limit, size) for limit, size in zip(CROP, image.shape[1::-1], strict=True))
    top, left = (image.shape[0] - height) // 2, (image.shape[1] - width) // 2
    return np.ascontiguousarray(image[top : top + height, left : left + width])


def _kept_features(original: Image, decoded: Image) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) of the original's ORB features, and which of them the decoded picture still has."""
    detector = cv2.ORB.create(300)
    before, after = (
        np.array([point.pt for point in detector.detect(gray_from_image(image), None)]).reshape(-1, 2)
        for image in (original, decoded)
    )
    if not len(before) or not len(after):
        return before, np.zeros(len(before), dtype=bool)
    distances = np.hypot(*(before[:, None, :] - after[None, :, :]).transpose(2, 0, 1))
    return before, distances.min(axis=1) <= _FOUND_PX


def _uri(image: Image) -> str:
    stored = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    _, buffer = cv2.imencode(".webp", stored, [cv2.IMWRITE_WEBP_QUALITY, _WEBP_QUALITY])
    return "data:image/webp;base64," + base64.b64encode(buffer.tobytes()).decode()
