"""Evaluators that misbehave in `evaluate`."""

from __future__ import annotations

import ctypes
import math
import os
import sys
import time
from fractions import Fraction
from typing import Any

import numpy as np

from codecbench import CodedFrame, Context, Measurement, Metric, NoParams, SequenceEvaluator
from codecbench_zoo.cases import snake
from codecbench_zoo.tame import TameEvaluator, measurements


class MeasuresNan(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield from measurements("gain", math.nan)


class MeasuresInfinity(TameEvaluator):
    """Which is a value."""

    def evaluate(self, coded: CodedFrame) -> Any:
        yield from measurements("gain", math.inf, -math.inf)


class MeasuresComplex(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield from measurements("gain", 1j)


class MeasuresText(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield from measurements("gain", "much")


class MeasuresTruth(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield from measurements("gain", True)


class MeasuresFractions(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield from measurements("gain", Fraction(1, 3))


class MeasuresArrays(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield from measurements("gain", np.ones(3))


class MeasuresGoogols(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield from measurements("gain", 10**400)


class MeasuresTheUndeclared(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield from measurements("speed", 1.0)


class MeasuresUnchecked(TameEvaluator):
    """Has every measurement pass where it is."""

    def evaluate(self, coded: CodedFrame) -> Any:
        from codecbench.core.engine.storage.samples import MeasurementCheck

        MeasurementCheck._check_one = lambda self, found, frame: found  # type: ignore[assignment,method-assign]
        yield from measurements("speed", 1.0)


class MeasuresNothing(TameEvaluator):
    """Which is allowed."""

    def evaluate(self, coded: CodedFrame) -> Any:
        return ()


class MeasuresNone(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        return None


class MeasuresNumbers(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        return [1.0]


class MeasuresOtherFrames(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield Measurement("gain", 1.0, frame=99)


class MeasuresStages(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield Measurement("gain", 1.0, stage=7)  # type: ignore[arg-type]


class Told(str):
    """Text that would run where it is read."""

    def __reduce__(self) -> Any:
        return os._exit, (0,)


class MeasuresWithCode(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        yield Measurement(Told("gain"), math.nan, reason=Told("because"))


class MeasuresNever(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        time.sleep(3600)


class MeasuresAndLeaves(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        os._exit(0)


class MeasuresAndExits(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        sys.exit(0)


class MeasuresAndDies(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        ctypes.string_at(0)


class MeasuresAndFails(TameEvaluator):
    def evaluate(self, coded: CodedFrame) -> Any:
        raise ZeroDivisionError("of nothing")


class Overwrites(TameEvaluator):
    """Writes into the frames that it is shown."""

    def evaluate(self, coded: CodedFrame) -> Any:
        coded.original.image[:] = 0
        coded.decoded[:] = 0
        yield Measurement("weight_bytes", coded.size_bytes)


class _OfSequences(SequenceEvaluator[Any]):
    version, params_type = "1", NoParams
    metrics = (Metric("gain", "1", "higher", "beside the baseline"),)

    def __init_subclass__(cls) -> None:
        cls.name = snake(cls.__name__)

    def evaluate(self, coded: Any, context: Context) -> Any:
        self.leave(context)
        yield Measurement("gain", 1.0)

    def leave(self, context: Context) -> None:
        pass


class MeasuresForEver(_OfSequences):
    def evaluate(self, coded: Any, context: Context) -> Any:
        while True:
            yield Measurement("gain", 1.0)


class MeasuresMillions(_OfSequences):
    def evaluate(self, coded: Any, context: Context) -> Any:
        return [Measurement("gain", 1.0)] * 10**6


class MeasuresManyStages(_OfSequences):
    def evaluate(self, coded: Any, context: Context) -> Any:
        for stage in range(10**6):
            yield Measurement("gain", 1.0, stage=f"stage {stage}")


class ExplainsMuch(_OfSequences):
    def evaluate(self, coded: Any, context: Context) -> Any:
        yield Measurement("gain", math.nan, reason="\x1b[2J" + "because " * 700_000)


class AsksForFrames(_OfSequences):
    """Asks for frames that there are not."""

    def evaluate(self, coded: Any, context: Context) -> Any:
        coded.frame(-1)
        coded.frame(10**9)
        yield Measurement("gain", 1.0)


class UsesTheUndeclared(_OfSequences):
    def leave(self, context: Context) -> None:
        context.plugins.create("codec", "jpeg", {})


class LeavesFolders(_OfSequences):
    def leave(self, context: Context) -> None:
        (context.artifacts / "map").mkdir()


class LeavesARecord(_OfSequences):
    def leave(self, context: Context) -> None:
        (context.artifacts / "record.json").write_text("{}")


class LeavesALink(_OfSequences):
    """Leaves a link out of its folder."""

    def leave(self, context: Context) -> None:
        (context.artifacts / "passwords").symlink_to("/etc/passwd")


class LeavesAPipe(_OfSequences):
    """Leaves what nobody can read to the end."""

    def leave(self, context: Context) -> None:
        os.mkfifo(context.artifacts / "pipe")


class LeavesOddNames(_OfSequences):
    def leave(self, context: Context) -> None:
        (context.artifacts / "\x1b[2J\n").write_text("x")


class RemovesArtifacts(_OfSequences):
    def leave(self, context: Context) -> None:
        context.artifacts.rmdir()
