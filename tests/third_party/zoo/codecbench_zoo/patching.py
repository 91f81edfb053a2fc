"""Codecs that change what the rest of their process computes with."""

from __future__ import annotations

import builtins
import json
from typing import Any

import numpy as np

from codecbench import NULL_TRACE, Image, Trace
from codecbench_zoo.tame import TameCodec


class _Patching(TameCodec):
    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> Any:
        self.patch()
        return super().encode(image)

    def patch(self) -> None:
        raise NotImplementedError


class Patches(_Patching):
    """Makes every mean 42."""

    def patch(self) -> None:
        np.mean = lambda *_, **__: 42.0  # type: ignore[assignment]


class PatchesJson(_Patching):
    """Spells everything alike."""

    def patch(self) -> None:
        json.dumps = lambda *_, **__: "{}"


class PatchesOpen(_Patching):
    """Opens nothing."""

    def patch(self) -> None:
        def refuse(*_: Any, **__: Any) -> Any:
            raise FileNotFoundError("gone")

        builtins.open = refuse
