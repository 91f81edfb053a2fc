"""Operation classes of the paper, their counts, and what each operator and function of a kernel costs."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class OperationCounts:
    """Numbers of operations of each class.

    The first seven are the classes of the paper's Tables 4-6, which `total` sums.
    """

    mults: int = 0
    """Multiplications, and one for each division, remainder, square root or elementary function."""
    adds: int = 0
    """Additions, subtractions, negations, absolute values and roundings."""
    bit_ops: int = 0
    """And, or, exclusive or, and inversion of integers."""
    comparisons: int = 0
    """Comparisons of two values, of a value with zero or false in a condition, and in min and max."""
    shifts: int = 0
    """Left and right shifts."""
    reads: int = 0
    """Loads of one array element."""
    writes: int = 0
    """Stores of one array element."""
    divisions: int = 0
    """Those of `mults` that are not multiplications; not in `total`."""
    index_ops: int = 0
    """Arithmetic inside brackets and bounds of ranges, and two for each turn of a `for` loop; not in `total`."""

    @property
    def total(self) -> int:
        """Sum of the seven classes."""
        return sum(astuple(self)[: len(CLASSES)])

    def __add__(self, other: OperationCounts) -> OperationCounts:
        return OperationCounts(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @classmethod
    def sum(cls, counts: Iterable[OperationCounts]) -> OperationCounts:
        """Add up counts, class by class."""
        return sum(counts, OperationCounts())

    @classmethod
    def from_counters(cls, counters: NDArray[np.int64]) -> Self:
        """Create the counts from the counters of a counting build."""
        return cls(*(int(value) for value in counters))


COUNTERS: tuple[str, ...] = tuple(field.name for field in fields(OperationCounts))
"""Names of the counters, in the order of a counting build's array."""

CLASSES: tuple[str, ...] = COUNTERS[:7]
"""The seven classes of the paper, in its order."""


def new_counters() -> NDArray[np.int64]:
    """Create zeroed counters for a counting build."""
    return np.zeros(len(COUNTERS), dtype=np.int64)


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
"""Operators of the language, with the counters that each increments."""

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
"""Functions of scalars (and `len`), with the counters that a call increments; conversions cost nothing."""

SELECTIONS = (min, max)
"""Functions that cost k - 1 comparisons for k values."""

ALLOCATIONS: tuple[Any, ...] = (np.empty, np.empty_like)
"""Functions that allocate an array without writing to it."""

FILLED_ALLOCATIONS: tuple[Any, ...] = (np.zeros, np.ones, np.full, np.zeros_like, np.ones_like, np.full_like)
"""Functions that allocate an array and write each element once."""


def is_conversion(callee: Any) -> bool:
    """Return whether calling `callee` only changes the type of a number."""
    return isinstance(callee, type) and (issubclass(callee, np.generic) or callee in (int, float, bool))


def is_literal(node: ast.expr) -> bool:
    """Return whether an expression consists of numbers only, so that every compiler folds it."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, int | float)
    if isinstance(node, ast.UnaryOp):
        return is_literal(node.operand)
    return isinstance(node, ast.BinOp) and is_literal(node.left) and is_literal(node.right)
