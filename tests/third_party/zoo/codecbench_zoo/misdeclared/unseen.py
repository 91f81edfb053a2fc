"""An evaluator that draws a metric that it does not declare."""

from codecbench import View
from codecbench_zoo.tame import TameEvaluator


class Unseen(TameEvaluator):
    views = (View("curve", "Speed", ("speed",)),)
