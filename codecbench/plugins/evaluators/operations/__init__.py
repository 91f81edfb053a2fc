"""The `operations` evaluator: operations counted in kernels, by the paper's formulas, or as executed instructions."""

from codecbench.plugins.evaluators.operations.evaluator import Operations

__all__ = ["Operations"]
