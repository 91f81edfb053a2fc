"""Depth of rendered sequences in millimeters: exact, or as a structured-light sensor measures it.

The sensor finds the disparity of a projected pattern, so its steps and its noise grow with the square of the distance.
Source of the constants: Khoshelham and Oude Elberink, "Accuracy and Resolution of Kinect Depth Data for Indoor Mapping
Applications", Sensors 12(2), 2012, doi:10.3390/s120201437.
"""

from __future__ import annotations

import hashlib
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera, Depth, Frame
from codecbench.plugins.datasets.adapted import AdaptedSequence
from codecbench.plugins.datasets.synthetic.rendered import RenderedSequence

Floats = NDArray[np.float64]
_UNIT: Final = Depth(0.001)
_STEP_PER_M: Final = 2.85e-3
"""Step of 1/z: of z it is 2.85 mm at 1 m and 71 mm at 5 m."""
_NOISE_STEPS: Final = 0.5
"""Standard deviation of the disparity, in its steps."""
_WINDOW_PX: Final = 9
"""Side of the window that the pattern is matched in, which correlates the noise of neighbors."""
_BASELINE_M: Final = 0.075
"""Distance of the projector, on the right of the camera."""
_RANGE_M: Final = (0.5, 10.0)
_LEAST_COSINE: Final = 0.2
"""Cosine of the angle of incidence below which too little of the pattern comes back."""
_DROPOUT_DEVIATIONS: Final = 2.5
"""Patches whose noise exceeds this are not measured: 0.6 % of all."""
_VERSION: Final = "1"


class DepthSequence(AdaptedSequence):
    """The depth of a rendered sequence at its frames' times. noise: factor on the sensor's; at 0 depth is exact."""

    def __init__(self, source: RenderedSequence, seed: int, noise: float) -> None:
        super().__init__(source)
        self.name += "_depth"
        self.channels, self.bits, self.depth = 1, 16, _UNIT
        text = f"{source.fingerprint} depth {_VERSION} {seed} {noise!r}"
        self.fingerprint = hashlib.sha256(text.encode()).hexdigest()
        self._rendered, self._seed, self._noise = source, seed, noise

    def read(self, index: int) -> Frame:
        source, camera = self._rendered.source(index), self._rendered.camera
        assert camera is not None
        distances_m = self._rendered.distances_m(source)
        if self._noise > 0.0:
            distances_m = measured(distances_m, camera, self._noise, np.random.default_rng([self._seed, 4, source]))
        steps = np.rint(distances_m / _UNIT.unit_m)
        image: Image = np.where(steps < 1 << 16, steps, _UNIT.unknown).astype(np.uint16)
        return Frame(index, float(self.timestamps_s[index]), image)


def measured(distances_m: Floats, camera: Camera, noise: float, rng: np.random.Generator) -> Floats:
    """What the sensor measures of distances (H, W) along the optical axis, in meters; 0 for unknown."""
    shape = distances_m.shape
    disparities = 1.0 / distances_m / _STEP_PER_M + noise * _NOISE_STEPS * _correlated(shape, rng)
    seen = (distances_m >= _RANGE_M[0]) & (distances_m <= _RANGE_M[1]) & ~_shadows(distances_m, camera.fx)
    seen &= (_cosines(distances_m, camera) >= _LEAST_COSINE) & (_correlated(shape, rng) <= _DROPOUT_DEVIATIONS)
    steps = np.rint(disparities)
    seen &= steps >= 1
    return np.where(seen, 1.0 / (_STEP_PER_M * np.maximum(steps, 1)), 0.0)


def _correlated(shape: tuple[int, ...], rng: np.random.Generator) -> Floats:
    """Normal numbers, correlated within the window: means over squares, by sums in an order that no library chooses."""
    values = rng.standard_normal((shape[0] + _WINDOW_PX, shape[1] + _WINDOW_PX))
    for _ in range(2):
        sums = np.cumsum(values, axis=0)
        values = (sums[_WINDOW_PX:] - sums[:-_WINDOW_PX]).T
    return values / _WINDOW_PX


def _shadows(distances_m: Floats, focal_px: float) -> NDArray[np.bool_]:
    """Pixels (H, W) that something on their right hides from the projector."""
    columns: Any = np.arange(distances_m.shape[1]) - focal_px * _BASELINE_M / distances_m  # as the projector sees them
    nearest = np.minimum.accumulate(columns[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(columns > nearest)


def _cosines(distances_m: Floats, camera: Camera) -> Floats:
    """Cosines (H, W) of the angle of incidence: 1/z is linear over a plane, and its slopes give the normal."""
    near = 1.0 / distances_m
    down, right = _slopes(near), _slopes(near.T).T
    y, x = np.indices(near.shape, float)
    x, y = x - camera.cx, y - camera.cy
    normals = (camera.fx * right) ** 2 + (camera.fy * down) ** 2 + (near - right * x - down * y) ** 2
    rays = (x / camera.fx) ** 2 + (y / camera.fy) ** 2 + 1.0
    return np.asarray(near / np.sqrt(np.maximum(normals * rays, 1e-300)))


def _slopes(values: Floats) -> Floats:
    """Differences from row to row (H, W): of the two at a pixel the smaller one, which crosses no edge."""
    steps = np.diff(values, axis=0)
    above, below = np.concatenate([steps[:1], steps]), np.concatenate([steps, steps[-1:]])
    return np.where(np.abs(above) < np.abs(below), above, below)
