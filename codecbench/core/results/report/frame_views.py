"""A frame of a setting for the page: the original, what the codec made of it, where they differ, what was lost."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from codecbench.core.contracts.evaluator import CodedFrame
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.view import Marks

_WEBP_QUALITY: Final = 82
_DIFFERENCE_QUALITY: Final = 60
_GAIN: Final = 4
"""Differences of gray are shown this many times stronger, around middle gray."""


@dataclass(frozen=True)
class FrameView:
    """Data URIs of the three pictures of frame `index`, and marks.

    width, height: of the pictures in pixels. kept, lost: x and y in turn of what an evaluator marks. note: what its
    marks say of the whole frame; empty where it has none.
    """

    index: int
    original: str
    decoded: str
    difference: str
    width: int
    height: int
    kept: list[int]
    lost: list[int]
    note: str

    @property
    def weight_bytes(self) -> int:
        return len(self.decoded) + len(self.difference) + 5 * (len(self.kept) + len(self.lost))


def frame_view(coded: CodedFrame, index: int, size: tuple[int, int], marks: Marks | None = None) -> FrameView:
    """The middle of a coded frame, `size` (width, height) of it at most, at one pixel a pixel. marks: of all of it."""
    top, left, height, width = _middle(coded.original.image, size)
    shown = slice(top, top + height), slice(left, left + width)
    original, decoded = (np.ascontiguousarray(image[shown]) for image in (coded.original.image, coded.decoded))
    difference = 128 + _GAIN * (gray_from_image(decoded).astype(np.int16) - gray_from_image(original))
    kept, lost = ([], []) if marks is None else (_inside(marks, found, shown) for found in (True, False))
    return FrameView(
        index,
        _uri(original, _WEBP_QUALITY),
        _uri(decoded, _WEBP_QUALITY),
        _uri(np.clip(difference, 0, 255).astype(np.uint8), _DIFFERENCE_QUALITY),
        width,
        height,
        kept,
        lost,
        "" if marks is None else marks.note,
    )


def _middle(image: Image, size: tuple[int, int]) -> tuple[int, int, int, int]:
    """Top, left, height and width of what is shown."""
    width, height = (min(limit, own) for limit, own in zip(size, image.shape[1::-1], strict=True))
    return (image.shape[0] - height) // 2, (image.shape[1] - width) // 2, height, width


def _inside(marks: Marks, found: bool, shown: tuple[slice, slice]) -> list[int]:
    """The marks that are kept, or those that are lost, in pixels of the part that is shown."""
    rows, columns = shown
    places = np.rint(marks.places[marks.kept == found] - [columns.start, rows.start]).astype(int)
    limits = np.array([columns.stop - columns.start, rows.stop - rows.start])
    within: list[int] = places[((places >= 0) & (places < limits)).all(axis=1)].ravel().tolist()
    return within


def _uri(image: Image, quality: int) -> str:
    stored = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    _, buffer = cv2.imencode(".webp", stored, [cv2.IMWRITE_WEBP_QUALITY, quality])
    return "data:image/webp;base64," + base64.b64encode(buffer.tobytes()).decode()
