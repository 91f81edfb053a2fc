"""What each operator and each function costs, and the functions that a kernel may call at all."""

from __future__ import annotations

import ast
import math
from typing import Any

import numpy as np

OPERATORS: dict[type[ast.AST], tuple[str, ...]] = {
    ast.Add: ("adds",),
    ast.Sub: ("adds",),
    ast.Mult: ("mults",),
    ast.Div: ("mults", "divisions"),
    ast.FloorDiv: ("mults", "divisions"),
    ast.Mod: ("mults", "divisions"),
    ast.LShift: ("shifts",),
    ast.RShift: ("shifts",),
    ast.BitAnd: ("bit_ops",),
    ast.BitOr: ("bit_ops",),
    ast.BitXor: ("bit_ops",),
    ast.USub: ("adds",),
    ast.Invert: ("bit_ops",),
    ast.UAdd: (),
    ast.Eq: ("comparisons",),
    ast.NotEq: ("comparisons",),
    ast.Lt: ("comparisons",),
    ast.LtE: ("comparisons",),
    ast.Gt: ("comparisons",),
    ast.GtE: ("comparisons",),
}
"""Operators of the language by the counters that one of them adds to."""

_ROUNDINGS = (round, math.floor, math.ceil, math.trunc, np.floor, np.ceil, np.trunc, np.rint)
_ELEMENTARY = tuple(
    getattr(module, name)
    for module in (math, np)
    for name in ("sqrt", "exp", "log", "log2", "log10", "sin", "cos", "tan")
)

FUNCTIONS: dict[Any, tuple[str, ...]] = {
    abs: ("adds",),
    math.fabs: ("adds",),
    **dict.fromkeys(_ROUNDINGS, ("adds",)),
    **dict.fromkeys(_ELEMENTARY, ("mults", "divisions")),
    len: (),
}
"""Functions of scalars (and `len`) by the counters that one call adds to; conversions cost nothing."""

SELECTIONS = (min, max)
"""min and max of k values cost k - 1 comparisons."""

ALLOCATIONS: tuple[Any, ...] = (np.empty, np.empty_like)
"""New memory that nothing is written to yet."""

FILLED_ALLOCATIONS: tuple[Any, ...] = (np.zeros, np.ones, np.full, np.zeros_like, np.ones_like, np.full_like)
"""New memory in which every element is written once."""


def is_conversion(callee: Any) -> bool:
    """Whether calling `callee` only changes the type of a number."""
    return isinstance(callee, type) and (issubclass(callee, np.generic) or callee in (int, float, bool))


def is_literal(node: ast.expr) -> bool:
    """Whether an expression is made of numbers alone, so that every compiler folds it."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float)
    if isinstance(node, ast.UnaryOp):
        return is_literal(node.operand)
    return isinstance(node, ast.BinOp) and is_literal(node.left) and is_literal(node.right)
