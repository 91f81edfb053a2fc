"""Datasets that misbehave when they are opened."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from codecbench import Dataset, Frame, NoParams, Sequence


class Broken(Dataset[NoParams]):
    name, version, params_type = "broken", "1", NoParams

    def open(self) -> Sequence:
        return {}["not there"]  # type: ignore[no-any-return]


class Abandoned(Dataset[NoParams]):
    name, version, params_type = "abandoned", "1", NoParams

    def open(self) -> Sequence:
        os._exit(3)


class _Unmarked(Sequence):
    name, frame_rate_hz, channels, camera, ground_truth = "unmarked", 1.0, 1, None, None
    timestamps_s: Any = np.zeros(1)

    def read(self, index: int) -> Frame:
        return Frame(index, 0.0, np.zeros((8, 8), np.uint8))


class Nameless(Dataset[NoParams]):
    """Opens a sequence without a fingerprint."""

    name, version, params_type = "nameless", "1", NoParams

    def open(self) -> Sequence:
        return _Unmarked()
