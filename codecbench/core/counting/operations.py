"""Operation counts in the seven classes of the paper, and what each class means."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import astuple, dataclass, fields
from typing import Self

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class OperationCounts:
    """How many operations of each class were carried out.

    The seven classes of the paper's Tables 4-6, which `total` adds up:
    mults: multiplications; divisions, remainders, square roots and elementary functions count as one each.
    adds: additions, subtractions, negations, absolute values and roundings.
    bit_ops: and, or, exclusive or, inversion of integers.
    comparisons: of two values, of a value with zero or false in a condition, and in min and max.
    shifts: left and right. reads, writes: loads and stores of one array element.

    Beside them, never in `total`: divisions, those of `mults` that are not multiplications; index_ops,
    arithmetic written inside brackets, bounds of ranges, and two for each turn of a `for` loop.
    """

    mults: int = 0
    adds: int = 0
    bit_ops: int = 0
    comparisons: int = 0
    shifts: int = 0
    reads: int = 0
    writes: int = 0
    divisions: int = 0
    index_ops: int = 0

    @property
    def total(self) -> int:
        """Operations of the seven classes together."""
        return sum(astuple(self)[: len(CLASSES)])

    def __add__(self, other: OperationCounts) -> OperationCounts:
        return OperationCounts(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @classmethod
    def sum(cls, counts: Iterable[OperationCounts]) -> OperationCounts:
        """All counts added up, class by class."""
        return sum(counts, OperationCounts())

    @classmethod
    def from_counters(cls, counters: NDArray[np.int64]) -> Self:
        """The counts that a counting build left in its counters."""
        return cls(*(int(value) for value in counters))


COUNTERS: tuple[str, ...] = tuple(field.name for field in fields(OperationCounts))
"""The names of the counters in the order in which a counting build keeps them."""

CLASSES: tuple[str, ...] = COUNTERS[:7]
"""The seven classes of the paper, in its order."""


def new_counters() -> NDArray[np.int64]:
    """Counters at zero, to be passed to a counting build."""
    return np.zeros(len(COUNTERS), dtype=np.int64)
