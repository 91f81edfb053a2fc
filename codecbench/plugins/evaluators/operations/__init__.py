"""How much work a codec does: counted in its kernels, computed from the paper's model, or executed."""

from codecbench.plugins.evaluators.operations.evaluator import Operations

__all__ = ["Operations"]
