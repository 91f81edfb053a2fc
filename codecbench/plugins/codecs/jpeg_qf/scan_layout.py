"""In which order the blocks of all components are coded (ITU-T T.81 A.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from codecbench.plugins.codecs.jfif.markers import FrameHeader


@dataclass(frozen=True)
class ScanLayout:
    """Where blocks are and when they are coded.

    Blocks of all components lie one component after another, each in raster order. grids: rows and columns of
    blocks of each component, whole MCUs. order: (N,) which block is coded when. pattern: (M,) the component of
    each of the M blocks of an MCU.
    """

    grids: tuple[tuple[int, int], ...]
    order: NDArray[np.int32]
    pattern: NDArray[np.int32]

    @property
    def mcus(self) -> int:
        return len(self.order) // len(self.pattern)


def scan_layout(header: FrameHeader) -> ScanLayout:
    """The layout of a frame's only scan: interleaved, or block by block where there is one component."""
    sampling = tuple((component.h, component.v) for component in header.components)
    return _layout(header.width, header.height, sampling if len(sampling) > 1 else ((1, 1),))


@lru_cache(maxsize=8)
def _layout(width: int, height: int, sampling: tuple[tuple[int, int], ...]) -> ScanLayout:
    mcu_rows = -(-height // (8 * max(v for _, v in sampling)))
    mcu_columns = -(-width // (8 * max(h for h, _ in sampling)))
    grids, orders, first = [], [], 0
    for h, v in sampling:
        rows, columns = mcu_rows * v, mcu_columns * h
        indices = np.arange(first, first + rows * columns, dtype=np.int32)
        by_mcu = indices.reshape(mcu_rows, v, mcu_columns, h).transpose(0, 2, 1, 3)
        orders.append(by_mcu.reshape(mcu_rows * mcu_columns, v * h))
        grids.append((rows, columns))
        first += rows * columns
    pattern = np.repeat(np.arange(len(sampling), dtype=np.int32), [h * v for h, v in sampling])
    return ScanLayout(tuple(grids), np.concatenate(orders, axis=1).reshape(-1), pattern)
