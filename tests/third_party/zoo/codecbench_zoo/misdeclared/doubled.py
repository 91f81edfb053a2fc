"""An evaluator that declares a metric twice."""

from codecbench import Metric
from codecbench_zoo.tame import TameEvaluator


class Doubled(TameEvaluator):
    metrics = (Metric("gain", "1", "higher", "once"), Metric("gain", "1", "higher", "twice"))
