"""Datasets that misbehave when they are opened, or open what is no sequence."""

from __future__ import annotations

import os
import sys
import time
from typing import Any

import numpy as np

from codecbench import FrameSequence
from codecbench_zoo.tame import TameDataset, TameSequence


class Broken(TameDataset):
    def open(self) -> Any:
        return {}["not there"]  # type: ignore[index]


class Abandoned(TameDataset):
    def open(self) -> Any:
        os._exit(3)


class Departs(TameDataset):
    def open(self) -> Any:
        sys.exit(0)


class OpensForEver(TameDataset):
    def open(self) -> Any:
        time.sleep(3600)


class OpensNothing(TameDataset):
    def open(self) -> Any:
        return None


class _Changed(TameDataset):
    """Opens a sequence with attributes that are not what they should be."""

    changed: dict[str, Any] = {}

    def open(self) -> FrameSequence:
        sequence = TameSequence(self.name)
        vars(sequence).update(self.changed)
        return sequence


class _Unmarked(TameSequence):
    def __init__(self) -> None:
        super().__init__("unmarked")
        del self.fingerprint


class Nameless(TameDataset):
    """Opens a sequence without a fingerprint."""

    def open(self) -> Any:
        return _Unmarked()


class OddName(_Changed):
    changed = {"name": 7}


class LongName(_Changed):
    """Has a name of ten thousand letters, with slashes and control characters."""

    changed = {"name": "../\x1b[2J\n" * 1400}


class Frameless(_Changed):
    changed = {"timestamps_s": np.zeros(0)}


class Untimely(_Changed):
    changed = {"timestamps_s": np.array([0.0, np.nan, 0.2])}


class Backwards(_Changed):
    changed = {"timestamps_s": np.array([0.2, 0.1, 0.0])}


class TwoDimensional(_Changed):
    changed = {"timestamps_s": np.zeros((3, 3))}


class FourChannels(_Changed):
    changed = {"channels": 4}


class _Long(TameSequence):
    def __len__(self) -> int:
        return 10**15


class Boundless(TameDataset):
    """Says that it has more frames than there are atoms in a picture."""

    def open(self) -> Any:
        return _Long(self.name)


class _Short(TameSequence):
    def __len__(self) -> int:
        return -1


class Negative(TameDataset):
    def open(self) -> Any:
        return _Short(self.name)


class Impostor(TameDataset):
    """Opens black frames that pass for the pictures of another dataset."""

    def open(self) -> Any:
        sequence = TameSequence(self.name)
        sequence.fingerprint = os.environ.get("ZOO_FINGERPRINT", "")
        return sequence
