"""Quantization tables and the zigzag order of ITU-T T.81.

Tables are (8, 8) int32, row = vertical frequency, column = horizontal frequency.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Table = NDArray[np.int32]


def _zigzag() -> NDArray[np.int32]:
    """Natural position, 8 * row + column, of each coefficient in zigzag order (T.81, figure A.6)."""

    def rank(position: int) -> tuple[int, int]:
        row, column = divmod(position, 8)
        diagonal = row + column
        return diagonal, row if diagonal % 2 else column

    return np.array(sorted(range(64), key=rank), dtype=np.int32)


ZIGZAG = _zigzag()

LUMINANCE: Table = np.array(
    [
        [16, 11, 10, 16, 24, 40, 51, 61],
        [12, 12, 14, 19, 26, 58, 60, 55],
        [14, 13, 16, 24, 40, 57, 69, 56],
        [14, 17, 22, 29, 51, 87, 80, 62],
        [18, 22, 37, 56, 68, 109, 103, 77],
        [24, 35, 55, 64, 81, 104, 113, 92],
        [49, 64, 78, 87, 103, 121, 120, 101],
        [72, 92, 95, 98, 112, 100, 103, 99],
    ],
    dtype=np.int32,
)
"""T.81, table K.1."""

CHROMINANCE: Table = np.array(
    [
        [17, 18, 24, 47, 99, 99, 99, 99],
        [18, 21, 26, 66, 99, 99, 99, 99],
        [24, 26, 56, 99, 99, 99, 99, 99],
        [47, 66, 99, 99, 99, 99, 99, 99],
        [99, 99, 99, 99, 99, 99, 99, 99],
        [99, 99, 99, 99, 99, 99, 99, 99],
        [99, 99, 99, 99, 99, 99, 99, 99],
        [99, 99, 99, 99, 99, 99, 99, 99],
    ],
    dtype=np.int32,
)
"""T.81, table K.2."""

FLAT: Table = np.full((8, 8), 16, dtype=np.int32)
"""Equal steps of 16, the DC step of K.1."""


def with_unit_head(table: Table) -> Table:
    """Copy `table` with 1 for DC and the next five zigzag entries.

    Source: Salih & Vasarhelyi, section 3, for the luminance table.
    """
    result = table.copy()
    result.reshape(64)[ZIGZAG[:6]] = 1
    return result


PAPER: Table = with_unit_head(LUMINANCE)
"""The paper's table: K.1 with 1 in the first six zigzag places."""

for _table in (ZIGZAG, LUMINANCE, CHROMINANCE, FLAT, PAPER):
    _table.flags.writeable = False


def steps_from_table(table: Table, factor: float) -> NDArray[np.float32]:
    """Return the quantization steps (64,), natural order: table * factor, rounded once to float32."""
    return (table.astype(np.float64) * float(factor)).astype(np.float32).reshape(64)
