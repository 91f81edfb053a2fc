"""Atlases of the places in synthetic scenes; each takes some seconds to make and is cached."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, lru_cache

import numpy as np

from codecbench.core.contracts.image import Image
from codecbench.plugins.datasets.synthetic.room import furnished_room, room_atlas
from codecbench.plugins.datasets.synthetic.scene import Atlas, Panel, make_atlas
from codecbench.plugins.datasets.synthetic.textures import round_to_uint8
from codecbench.plugins.datasets.synthetic.worlds.corridor import corridor
from codecbench.plugins.datasets.synthetic.worlds.field import farmland
from codecbench.plugins.datasets.synthetic.worlds.presets import Place
from codecbench.plugins.datasets.synthetic.worlds.street import town, van


@lru_cache(maxsize=2)
def place_atlas(place: Place, contrast: float, distinctness: float) -> Atlas:
    """The atlas of a place, with scaled contrast and the given distinctness of repeated surfaces."""
    if place == "room" and contrast == 1.0:
        return room_atlas()
    panels = _panels(place, distinctness)
    moving_count = len(van()) if place == "street_and_van" else 0
    return replace(
        make_atlas(panels if contrast == 1.0 else scale_contrast(panels, contrast)), moving_count=moving_count
    )


@cache
def _panels(place: Place, distinctness: float) -> list[Panel]:
    if place == "room":
        return furnished_room()
    if place == "corridor":
        return corridor(distinctness)
    if place == "street_and_van":
        return town() + van()
    return town() if place == "street" else farmland()


def scale_contrast(panels: list[Panel], contrast: float) -> list[Panel]:
    """Scale the contrast of textures about their mean color; lamps stay unchanged."""
    textures: dict[int, Image] = {}
    for panel in panels:
        if id(panel.texture) not in textures:
            mean = panel.texture.mean(axis=(0, 1), dtype=np.float64)
            textures[id(panel.texture)] = round_to_uint8(mean + contrast * (panel.texture - mean))
    return [panel if panel.glows else replace(panel, texture=textures[id(panel.texture)]) for panel in panels]
