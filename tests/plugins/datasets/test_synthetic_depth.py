"""Depth of rendered scenes: geometry, by moving points between views, and the sensor on scenes with known answers."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from codecbench.core.contracts.image import Layout
from codecbench.core.contracts.sequence import Camera, Depth
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.synthetic.depth import measured

CAMERA = Camera(200, 120, 300.0, 300.0, 99.5, 59.5)
SMALL = {"width": 160, "height": 120, "stream": "depth"}


@pytest.mark.parametrize("world", [None, "corridor_loop", "road_behind_van"])
def test_exact_depth_moves_points_from_view_to_view(world: str | None) -> None:
    sequence = Synthetic.create(**SMALL, depth_noise=0, world=world, frames=40).open()
    assert (sequence.layout, sequence.depth, sequence.name[-6:]) == (Layout(1, 16), Depth(0.001), "_depth")
    camera, poses = sequence.camera, sequence.ground_truth.world_from_camera
    first, second = (sequence.read(index).image.astype(float) / 1000 for index in (0, 2))
    y, x = np.indices(first.shape)
    points = np.stack([(x - camera.cx) / camera.fx * first, (y - camera.cy) / camera.fy * first, first], axis=-1)
    known = first > 0
    second_from_first = np.linalg.inv(poses[2]) @ poses[0]
    moved = points[known] @ second_from_first[:3, :3].T + second_from_first[:3, 3]
    columns = np.rint(moved[:, 0] / moved[:, 2] * camera.fx + camera.cx).astype(int)
    rows = np.rint(moved[:, 1] / moved[:, 2] * camera.fy + camera.cy).astype(int)
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height) & (moved[:, 2] > 0)
    around = np.ones((3, 3), np.uint8)  # a point is moved to a whole pixel, and the ground is steep
    nearest, farthest = (find(second, around)[rows[inside], columns[inside]] for find in (cv2.erode, cv2.dilate))
    expected = moved[inside, 2]
    assert inside.mean() > 0.4
    assert np.mean((expected > 0.998 * nearest) & (expected < 1.002 * farthest)) > 0.93


@pytest.mark.parametrize("distance_m", [1.0, 3.0])
def test_noise_and_steps_grow_with_the_square_of_the_distance(distance_m: float) -> None:
    wall = np.full((CAMERA.height, CAMERA.width), distance_m)
    found = measured(wall, CAMERA, 1.0, np.random.default_rng(1))
    known = found[found > 0]
    assert 0.98 < known.size / found.size < 1.0
    step_m = 2.85e-3 * distance_m**2
    assert known.mean() == pytest.approx(distance_m, abs=0.2 * step_m)
    assert known.std() == pytest.approx(step_m * np.hypot(0.5, 12**-0.5), rel=0.15)
    assert np.diff(np.unique(known)) == pytest.approx(step_m, rel=0.03)


def test_shadows_lie_on_the_left_of_what_casts_them_and_gaps_where_nothing_comes_back() -> None:
    scene = np.full((CAMERA.height, CAMERA.width), 4.0)
    scene[40:80, 80:120] = 1.0
    scene[:10], scene[10:20] = 11.0, np.inf
    slanted = 1.0 / (0.5 + 0.02 * np.arange(40))
    scene[90:, 160:] = slanted
    found = measured(scene, CAMERA, 1e-6, np.random.default_rng(2))
    known = found > 0
    shadow_px = 300.0 * 0.075 * (1 / 1.0 - 1 / 4.0)
    unknown = np.count_nonzero(~known[45:75, 55:80], axis=1)
    assert np.median(unknown) == pytest.approx(shadow_px, abs=1.0)
    assert known[45:75, 82:118].mean() > 0.97
    assert known[45:75, 120:160].mean() > 0.97
    assert not known[:20].any()
    assert not known[92:, 162:198].any()  # 0.02 / px of 1/z at 0.5 to 1.3 1/m: steeper than 78 degrees


def test_depth_is_repeatable_and_its_noise_has_an_identity() -> None:
    noisy, exact = (Synthetic.create(**SMALL, frames=3, depth_noise=noise).open() for noise in (1, 0))
    again = Synthetic.create(**SMALL, frames=3, start=1).open()
    assert np.array_equal(noisy.read(1).image, again.read(0).image)
    color = Synthetic.create(width=160, height=120, frames=3).open()
    assert len({sequence.fingerprint for sequence in (noisy, exact, again, color)}) == 4
    with pytest.raises(ValidationError, match="depth is gray"):
        Synthetic.create(stream="depth", color="rgb")
