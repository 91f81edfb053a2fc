"""The `localization` evaluator: where decoded frames are in a map of the raw ones."""

from codecbench.plugins.evaluators.localization.evaluator import Localization

__all__ = ["Localization"]
