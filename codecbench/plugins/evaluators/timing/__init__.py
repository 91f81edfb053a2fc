"""How long encoding and decoding take."""

from codecbench.plugins.evaluators.timing.evaluator import Timing

__all__ = ["Timing"]
