"""An evaluator that declares a role that there is not."""

from codecbench import Metric
from codecbench_zoo.tame import TameEvaluator


class Heroic(TameEvaluator):
    metrics = (Metric("gain", "1", "higher", "the more the better", role="hero"),)  # type: ignore[arg-type]
