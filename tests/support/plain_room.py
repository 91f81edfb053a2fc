"""A room that is made at once, for tests of what does not depend on the furniture."""

from __future__ import annotations

from codecbench.plugins.datasets.synthetic.scene import Panel, upright
from codecbench.plugins.datasets.synthetic.textures import photograph


def walls(side_m: float) -> list[Panel]:
    """Four walls of a square room about the origin, each a photograph of fine grain."""
    half_m, height_m = side_m / 2, 0.75 * side_m
    places = {-90: (0, half_m), 90: (0, -half_m), 180: (half_m, 0), 0: (-half_m, 0)}
    return [
        upright((x, y, height_m / 2), facing_deg, side_m, height_m, photograph("coffee"))
        for facing_deg, (x, y) in places.items()
    ]
