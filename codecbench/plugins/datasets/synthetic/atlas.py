"""Panels as arrays for compiled code: edges in space, and every texture with its reductions in one block."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.plugins.datasets.synthetic.scene import Panel
from codecbench.plugins.datasets.synthetic.textures import halved, rounded


@dataclass(frozen=True)
class Atlas:
    """What the renderer reads.

    edges: (P, 3, 3) corner, right and down of each panel, metres, world. texels: (N,) uint32, all levels of all
    textures, row by row, red in the lowest byte. first_level: (P,) row of `levels` at which a panel's texture
    begins. level_count: (P,). levels: (L, 3) offset into `texels`, height, width; each level has half the sides
    of the one before. carried: so many panels at the end belong to a thing that moves.
    """

    edges: NDArray[np.float64]
    texels: NDArray[np.uint32]
    first_level: NDArray[np.int64]
    level_count: NDArray[np.int64]
    levels: NDArray[np.int64]
    carried: int = 0


def edges_of(panels: Sequence[Panel]) -> NDArray[np.float64]:
    """(P, 3, 3) corner, right and down of each panel."""
    return np.array([[panel.corner, panel.right, panel.down] for panel in panels])


def make_atlas(panels: Sequence[Panel]) -> Atlas:
    """Reduce every texture down to one texel and lay them end to end; one array on several panels is kept once."""
    blocks: list[NDArray[np.uint32]] = []
    levels: list[tuple[int, int, int]] = []
    first_level, level_count = [], []
    offset = 0
    known: dict[int, tuple[int, int]] = {}
    for panel in panels:
        if id(panel.texture) in known:
            first, count = known[id(panel.texture)]
            first_level.append(first)
            level_count.append(count)
            continue
        first_level.append(len(levels))
        pixels = panel.texture.astype(np.float32)
        while True:
            height, width = pixels.shape[:2]
            levels.append((offset, height, width))
            blocks.append(_packed(rounded(pixels)))
            offset += height * width
            if height == width == 1:
                break
            pixels = halved(pixels)
        level_count.append(len(levels) - first_level[-1])
        known[id(panel.texture)] = first_level[-1], level_count[-1]
    return Atlas(
        edges=edges_of(panels),
        texels=np.concatenate(blocks),
        first_level=np.array(first_level, np.int64),
        level_count=np.array(level_count, np.int64),
        levels=np.array(levels, np.int64),
    )


def _packed(image: Image) -> NDArray[np.uint32]:
    colors = image.reshape(-1, 3).astype(np.uint32)
    return np.asarray(colors[:, 0] | colors[:, 1] << 8 | colors[:, 2] << 16, dtype=np.uint32)
