"""Evaluators that misbehave when tables and reports are made."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator

from codecbench import CodedFrame, Drawing, FrameEvaluator, Measurement, Metric, NoParams, Outcome, View


class _Sized(FrameEvaluator[NoParams]):
    version = "1"
    params_type = NoParams
    metrics = (
        Metric("weight_bytes", "bytes", "lower", "size of the bitstream", headline=True),
        Metric("gain", "1", "higher", "beside the baseline", headline=True),
    )

    def evaluate(self, coded: CodedFrame) -> Iterator[Measurement]:
        yield Measurement("weight_bytes", coded.size_bytes)


class Comparing(_Sized):
    name = "comparing"

    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        time.sleep(3600)
        yield Measurement("gain", 1.0)


class Quitting(_Sized):
    name = "quitting"
    views = (View("map", "Where it went"),)

    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        sys.exit("no comparison today")

    def drawing(self, outcome: Outcome) -> Drawing | None:
        os._exit(0)


class Uncertain(_Sized):
    name = "uncertain"

    @property
    def repeats(self) -> int:
        raise RuntimeError("it depends")
