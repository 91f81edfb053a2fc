"""The `features` evaluator."""

from codecbench.plugins.evaluators.features.evaluator import Features, FeaturesParams

__all__ = ["Features", "FeaturesParams"]
