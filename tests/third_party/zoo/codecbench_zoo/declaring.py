"""Evaluators that misbehave in what they declare."""

from __future__ import annotations

import math
import sys
import time
from typing import Any

from codecbench import Evaluator, FrameEvaluator, Measurement, Metric, NoParams, PluginUse
from codecbench_zoo.tame import TameEvaluator


class Uncertain(TameEvaluator):
    @property
    def repeats(self) -> int:
        raise RuntimeError("it depends")


class Countless(TameEvaluator):
    repeats = 10**9  # type: ignore[assignment]


class Halves(TameEvaluator):
    repeats = 2.5  # type: ignore[assignment]


class QuitsWhenAsked(TameEvaluator):
    @property
    def uses(self) -> Any:
        sys.exit(0)


class UsesWhatIsNot(TameEvaluator):
    uses = (PluginUse("codec", "not_there"),)  # type: ignore[assignment]


class UsesItself(TameEvaluator):
    uses = (PluginUse("evaluator", "uses_itself"),)  # type: ignore[assignment]


class NeedsNothingKnown(TameEvaluator):
    needs = None  # type: ignore[assignment]


class Timeless(TameEvaluator):
    typical_ms_per_frame = math.nan


class Shapeless(Evaluator[Any]):
    """Of none of the three kinds."""

    name, version, params_type, metrics = "shapeless", "1", NoParams, ()


class Loud(FrameEvaluator[Any]):
    """Names a metric with control characters, slashes and ten thousand letters."""

    name, version, params_type = "loud", "1", NoParams
    metrics = (Metric("../\x1b[2J\n" * 1400, "\x1b[31m", "lower", "\x07", headline=True, role="quality"),)

    def evaluate(self, coded: Any) -> Any:
        yield Measurement(self.metrics[0].name, 1.0, reason=None)


class Mimics(FrameEvaluator[Any]):
    """Names its metric as ours is named."""

    name, version, params_type = "mimics", "1", NoParams
    metrics = (Metric("psnr_gray_db", "dB", "higher", "made up", headline=True, role="quality"),)

    def evaluate(self, coded: Any) -> Any:
        yield Measurement("psnr_gray_db", 42.0)


class Ages(TameEvaluator):
    """Takes its time to say how often it repeats."""

    @property
    def repeats(self) -> int:
        time.sleep(3600)
        return 1
