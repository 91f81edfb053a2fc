"""Frames of 16 bits: noise, extremes, made-up depth with and without holes, and real depth."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from codecbench import Image

NOISE = np.random.default_rng(3)
ROWS, COLUMNS = np.indices((60, 83))
DEPTH = np.asarray(900 + 20 * ROWS + 7 * COLUMNS + 1500 * (COLUMNS > 40) + NOISE.integers(0, 9, ROWS.shape), np.uint16)
HOLES = np.where((NOISE.random(DEPTH.shape) < 0.1) | (COLUMNS < 9), 0, DEPTH).astype(np.uint16)
IMAGES = {
    "noise": NOISE.integers(0, 1 << 16, (33, 47), dtype=np.uint16),
    "depth": DEPTH,
    "holes": HOLES,
    "black": np.zeros((17, 20), np.uint16),
    "white": np.full((17, 20), 65535, np.uint16),
    "black and white": np.asarray(np.indices((16, 24)).sum(axis=0) % 2 * 65535, np.uint16),
    "ends in a hole": np.array([[0, 0, 65535, 1, 0]], np.uint16),
    "starts without a hole": np.array([[1, 65535, 256], [0, 0, 255]], np.uint16),
    "one pixel": np.array([[515]], np.uint16),
    "one black pixel": np.zeros((1, 1), np.uint16),
    "a row": NOISE.integers(0, 1 << 16, (1, 301), dtype=np.uint16),
    "a column": NOISE.integers(0, 1 << 16, (301, 1), dtype=np.uint16),
}


@cache
def real_frames() -> list[Image]:
    folder = Path(os.environ.get("CODECBENCH_DATA", ""), "sevenscenes_400", "depth")
    paths = sorted(folder.glob("*.png"))[10::130] if "CODECBENCH_DATA" in os.environ else []
    if not paths:
        pytest.skip("CODECBENCH_DATA has no sevenscenes_400")
    return [np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)) for path in paths]
