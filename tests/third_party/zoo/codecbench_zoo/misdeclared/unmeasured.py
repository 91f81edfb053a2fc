"""An evaluator whose metrics are no list."""

from codecbench_zoo.tame import TameEvaluator


class Unmeasured(TameEvaluator):
    metrics = None  # type: ignore[assignment]
