"""Evaluators that misbehave when tables and reports are made."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from codecbench import Drawing, Line, Measurement, Outcome, View
from codecbench_zoo.tame import TameEvaluator, measurements


class Comparing(TameEvaluator):
    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        time.sleep(3600)
        yield Measurement("gain", 1.0)


class Quitting(TameEvaluator):
    views = (View("map", "Where it went"),)

    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        sys.exit("no comparison today")

    def drawing(self, outcome: Outcome) -> Drawing | None:
        os._exit(0)


class _Comparing(TameEvaluator):
    found: Any = ()

    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Any:
        return self.found


class ComparesNone(_Comparing):
    found = None


class ComparesNan(_Comparing):
    found = (Measurement("gain", math.nan),)


class ComparesTheUndeclared(_Comparing):
    found = (Measurement("speed", 1.0),)


class ComparesText(_Comparing):
    found = (Measurement("gain", "much"),)  # type: ignore[arg-type]


class ComparesMillions(TameEvaluator):
    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        return measurements("gain", *range(10**6))


class ComparesWell(_Comparing):
    found = (Measurement("gain", 1.0),)


class _Drawing(TameEvaluator):
    views = (View("map", "Where it went"),)
    drawn: Any = None

    def drawing(self, outcome: Outcome) -> Any:
        return self.drawn


class DrawsText(_Drawing):
    drawn = "a picture"


class DrawsNowhere(_Drawing):
    drawn = Drawing((Line("path", "truth", np.full((3, 2), np.nan)),), "\x1b[2Jnowhere")


class DrawsMillions(_Drawing):
    def drawing(self, outcome: Outcome) -> Any:
        return Drawing((Line("path", "truth", np.zeros((3_000_000, 2))),), "much")


class DrawsForEver(_Drawing):
    def drawing(self, outcome: Outcome) -> Any:
        time.sleep(3600)
