"""The sequence of a named synthetic scene."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera
from codecbench.plugins.datasets.selection import Selection
from codecbench.plugins.datasets.synthetic.paths import Drive
from codecbench.plugins.datasets.synthetic.rendered import RenderedSequence
from codecbench.plugins.datasets.synthetic.textures import photographs_digest
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLDS, Place, WorldName

if TYPE_CHECKING:
    from codecbench.plugins.datasets.synthetic.worlds.exposure import Exposure, Floats, Pose

WORLDS_VERSION = "1"
"""Version of the rendered frames, part of the fingerprint; increase it if any frame changes."""

_SWING_PERIOD_S = 2.0
_DARK_S, _DAWN_S = 0.9, 0.2
"""Duration of the first light, and of its rise to full light."""


class WorldSequence(RenderedSequence):
    """A synthetic scene at one severity; its conditions are the same for all frames."""

    def __init__(
        self,
        world: WorldName,
        severity: float,
        selection: Selection,
        frames: int,
        rate_hz: float,
        size: tuple[int, int],
        seed: int,
    ) -> None:
        self._world = WORLDS[world]
        self._seed = seed
        self.conditions = self._world.at(severity)
        width, height = size
        focal_px = self._world.focal * width
        camera = Camera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)
        pixel_inputs = ["worlds", WORLDS_VERSION, world, severity, rate_hz, width, height, seed, photographs_digest()]
        path = self._world.path(self.conditions, seed)
        super().__init__(f"{world}-{severity:g}", selection, frames, rate_hz, camera, path, pixel_inputs)

    def render(self, source: int) -> Image:
        # Imported here because they load numba, which cached frames do not need.
        from codecbench.plugins.datasets.synthetic.worlds.exposure import samples_for
        from codecbench.plugins.datasets.synthetic.worlds.sensor import Sensor

        conditions, camera = self.conditions, self.camera
        assert camera is not None
        exposure, carrier = self._exposure(camera)
        time_s, open_s = source / self._rate_hz, conditions.exposure / self._rate_hz
        pose = self.path.world_from_camera
        samples = samples_for(pose, time_s, open_s, camera.fx, self._world.view_m)
        total = exposure.total(pose, time_s, open_s, conditions.readout / self._rate_hz, samples, carrier)
        sensor = Sensor(conditions.electrons, conditions.brightness, conditions.lens_blur_px)
        gain = 2.0 ** (conditions.swing_stops * np.sin(2 * np.pi * time_s / _SWING_PERIOD_S))
        dusk = min(max((time_s - _DARK_S) / _DAWN_S, 0.0), 1.0)
        gain *= conditions.first_light + (1.0 - conditions.first_light) * dusk
        key = int(np.random.default_rng([self._seed, 3, source]).integers(2**63))
        return sensor.expose(total, samples, float(gain), key)

    def distances_m(self, source: int) -> Floats:
        assert self.camera is not None
        exposure, carrier = self._exposure(self.camera)
        return exposure.distances_m(self.path.world_from_camera, source / self._rate_hz, carrier)

    def _exposure(self, camera: Camera) -> tuple[Exposure, Pose | None]:
        """What renders the scene, and the position of its moving panels."""
        conditions = self.conditions
        exposure = _exposure(self._world.place, conditions.contrast, conditions.distinctness, camera)
        return exposure, self.path.van_m if isinstance(self.path, Drive) else None


@lru_cache(maxsize=2)
def _exposure(place: Place, contrast: float, distinctness: float, camera: Camera) -> Exposure:
    # Imported here because they load numba, which cached frames do not need.
    from codecbench.plugins.datasets.synthetic.worlds.exposure import Exposure
    from codecbench.plugins.datasets.synthetic.worlds.places import place_atlas

    return Exposure(place_atlas(place, contrast, distinctness), camera)
