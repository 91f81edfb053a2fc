"""Datasets that open well and misbehave when their frames are read."""

from __future__ import annotations

import os
import time
from dataclasses import replace
from typing import Any

import numpy as np

from codecbench import DatasetError, Frame, Trajectory
from codecbench_zoo.tame import TameDataset, TameSequence


class _Reading(TameSequence):
    def __init__(self, name: str, spoil: Any) -> None:
        super().__init__(name)
        self.spoil = spoil

    def read(self, index: int) -> Any:
        return self.spoil(super().read(index))


class _Spoiling(TameDataset):
    def open(self) -> Any:
        return _Reading(self.name, self.spoilt)

    def spoilt(self, frame: Frame) -> Any:
        raise NotImplementedError


class ReadsNone(_Spoiling):
    def spoilt(self, frame: Frame) -> Any:
        return None


class ReadsFloats(_Spoiling):
    def spoilt(self, frame: Frame) -> Any:
        return replace(frame, image=frame.image / 255.0)


class ReadsEmpty(_Spoiling):
    def spoilt(self, frame: Frame) -> Any:
        return replace(frame, image=frame.image[:0])


class ReadsLists(_Spoiling):
    def spoilt(self, frame: Frame) -> Any:
        return replace(frame, image=frame.image.tolist())


class ReadsColor(_Spoiling):
    """Says gray and gives color."""

    def spoilt(self, frame: Frame) -> Any:
        return replace(frame, image=np.stack([frame.image] * 3, axis=-1))


class ReadsFails(_Spoiling):
    def spoilt(self, frame: Frame) -> Any:
        if frame.index == 2:
            raise DatasetError("frames.bin, byte 17: torn")
        return frame


class ReadsLeaves(_Spoiling):
    def spoilt(self, frame: Frame) -> Any:
        os._exit(0)


class ReadsForEver(_Spoiling):
    def spoilt(self, frame: Frame) -> Any:
        time.sleep(3600)


class Grows(_Spoiling):
    """Has frames of different sizes, which is allowed."""

    def spoilt(self, frame: Frame) -> Any:
        return replace(frame, image=np.tile(frame.image, (1 + frame.index, 1)))


class ChangesItsMind(TameDataset):
    """Is another sequence each time that it is opened."""

    def open(self) -> Any:
        sequence = TameSequence(self.name)
        sequence.fingerprint = str(time.monotonic_ns())
        return sequence


class LongTruth(TameDataset):
    """Has a ground truth of other lengths than frames."""

    def open(self) -> Any:
        sequence = TameSequence(self.name)
        vars(sequence)["ground_truth"] = Trajectory(np.arange(9.0), np.zeros((2, 4, 4)))
        return sequence
