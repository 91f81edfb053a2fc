"""The `stream` evaluator: what a link and a viewer have of a codec, beside its pictures."""

from codecbench.plugins.evaluators.stream.evaluator import Stream

__all__ = ["Stream"]
