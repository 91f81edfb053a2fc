"""Which settings nobody beats in everything at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray


def pareto_front(values: ArrayLike, better: Sequence[Literal["higher", "lower"]]) -> NDArray[np.bool_]:
    """Mark the rows that no other row dominates.

    values: (N, D), one row a setting, one column a criterion. A row dominates another where it is at least
    as good in every column and better in one. Rows with a NaN (a failure) are never on the front and
    dominate nobody. Equal rows are on the front together. Raises ValueError where `better` does not fit.
    """
    array = np.atleast_2d(np.asarray(values, dtype=np.float64))
    if array.shape[1] != len(better):
        raise ValueError(f"{array.shape[1]} columns but {len(better)} directions")
    unknown = set(better) - {"higher", "lower"}
    if unknown:
        raise ValueError(f"direction must be 'higher' or 'lower'; got {sorted(unknown)}")
    costs = array * np.where(np.array(better) == "higher", -1.0, 1.0)
    present = ~np.isnan(costs).any(axis=1)
    front = np.zeros(len(costs), dtype=bool)
    for index in np.flatnonzero(present):
        others = costs[present]
        dominated = (others <= costs[index]).all(axis=1) & (others < costs[index]).any(axis=1)
        front[index] = not dominated.any()
    return front
