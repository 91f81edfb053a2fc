"""An evaluator that declares a direction that there is not."""

from codecbench import Metric
from codecbench_zoo.tame import TameEvaluator


class Upwards(TameEvaluator):
    metrics = (Metric("gain", "1", "up", "the more the better"),)  # type: ignore[arg-type]
