"""An evaluator that declares a metric without a unit."""

from codecbench import Metric
from codecbench_zoo.tame import TameEvaluator


class Unitless(TameEvaluator):
    metrics = (Metric("gain"),)  # type: ignore[call-arg]
