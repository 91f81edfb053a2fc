"""Rate and image quality, frame by frame."""

from codecbench.plugins.evaluators.quality.evaluator import Quality

__all__ = ["Quality"]
