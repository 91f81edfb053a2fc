"""Frames of another size: where things are in them, what the camera is, and what is refused."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from plain_room import walls
from pydantic import ValidationError

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Camera
from codecbench.plugins.datasets.adapted import scaled_camera
from codecbench.plugins.datasets.folder import Folder
from codecbench.plugins.datasets.synthetic import dataset, rendered
from codecbench.plugins.datasets.synthetic.dataset import Synthetic, room_camera
from codecbench.plugins.datasets.synthetic.render import Renderer
from codecbench.plugins.datasets.synthetic.scene import make_atlas
from codecbench.plugins.datasets.tum import Tum

WIDTH, HEIGHT = 160, 120


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Of frames; that of kernels is everybody's."""
    monkeypatch.setattr(rendered, "cache_folder", lambda: tmp_path / "cache")


@pytest.fixture
def spot(tmp_path):
    """A folder with one picture of a soft spot, and what projects a point onto its middle."""
    camera = Camera(WIDTH, HEIGHT, 150.0, 140.0, 77.3, 61.8)
    point = np.array([0.11, -0.23, 1.3])
    x, y = camera.fx * point[0] / point[2] + camera.cx, camera.fy * point[1] / point[2] + camera.cy
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    light = 200.0 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / (2 * 5.0**2))
    folder = tmp_path / "spot"
    folder.mkdir()
    assert cv2.imwrite(str(folder / "0.png"), np.rint(light).astype(np.uint8))
    sizes = f"width: {WIDTH}\nheight: {HEIGHT}\n"
    (tmp_path / "calib.yaml").write_text(f"{sizes}fx: {camera.fx}\nfy: {camera.fy}\ncx: {camera.cx}\ncy: {camera.cy}\n")
    return {"path": folder, "calibration": tmp_path / "calib.yaml"}, point


@pytest.mark.parametrize("scale", [0.25, 0.4, 0.77, 1.0, 1.3, 2.0])
def test_a_point_is_seen_where_the_scaled_camera_projects_it(spot, scale):
    params, point = spot
    sequence = Folder.create(**params, scale=scale).open()
    camera, image = sequence.camera, sequence.read(0).image.astype(np.float64)
    assert image.shape == (camera.height, camera.width) == (round(HEIGHT * scale), round(WIDTH * scale))
    rows, columns = np.mgrid[: camera.height, : camera.width]
    middle = (image * columns).sum() / image.sum(), (image * rows).sum() / image.sum()
    projected = camera.fx * point[0] / point[2] + camera.cx, camera.fy * point[1] / point[2] + camera.cy
    np.testing.assert_allclose(middle, projected, atol=0.02)


@pytest.mark.parametrize(("rendered", "scale"), [(192, 0.5), (96, 2.0)])
def test_a_scaled_scene_is_the_scene_of_the_scaled_camera(rendered, scale, monkeypatch):
    atlas = make_atlas(walls(6.0))
    monkeypatch.setattr(dataset, "_renderer", lambda *size: Renderer(atlas, room_camera(*size)))

    def room(width, **values):
        return Synthetic.create(width=width, height=width * 3 // 4, frames=2, noise=0.0, **values).open()

    scaled, wanted = room(rendered, scale=scale), room(round(rendered * scale))
    assert scaled.camera == wanted.camera
    np.testing.assert_array_equal(scaled.timestamps_s, wanted.timestamps_s)
    np.testing.assert_array_equal(scaled.ground_truth.world_from_camera, wanted.ground_truth.world_from_camera)
    for mine, other in zip(scaled, wanted, strict=True):
        mine, other = (cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY).astype(np.float64) for frame in (mine, other))
        shift, _ = cv2.phaseCorrelate(mine, other, cv2.createHanningWindow(mine.shape[::-1], cv2.CV_64F))
        np.testing.assert_allclose(shift, 0.0, atol=0.1)  # a camera that forgets half a pixel is 0.25 or 0.5 away
        assert np.corrcoef(mine.ravel(), other.ravel())[0, 1] > 0.95


def test_only_lengths_in_pixels_are_scaled():
    camera = Camera(640, 480, 400.0, 410.0, 319.5, 250.0, (0.1, -0.2, 0.0, 0.001, 0.0))
    half = scaled_camera(camera, (320, 240))
    assert half == Camera(320, 240, 200.0, 205.0, 159.5, 124.75, camera.distortion)
    assert scaled_camera(half, (640, 480)) == camera


def test_smaller_pixels_are_means_over_areas(tmp_path):
    rng = np.random.default_rng(3)
    image = rng.integers(0, 256, (64, 48), dtype=np.uint8)
    assert cv2.imwrite(str(tmp_path / "0.png"), image)
    small = Folder.create(path=tmp_path, scale=0.5).open()
    means = image.reshape(32, 2, 24, 2).mean(axis=(1, 3))
    assert np.abs(small.read(0).image - means).max() <= 0.5
    assert small.camera is None
    assert any("48x64" in note and "24x32" in note for note in small.notes)


def test_scaling_is_part_of_what_a_sequence_is(spot):
    params, _ = spot
    whole = Folder.create(**params).open()
    assert Folder.create(**params, scale=1.0).open().fingerprint == whole.fingerprint
    prints = {whole.fingerprint, *(Folder.create(**params, scale=scale).open().fingerprint for scale in (0.5, 2.0))}
    assert len(prints) == 3
    assert Folder.create(**params, scale=0.5).open().fingerprint in prints


def test_frames_of_several_sizes_are_scaled_each(tmp_path):
    for number, shape in enumerate(((40, 60), (60, 40))):
        assert cv2.imwrite(str(tmp_path / f"{number}.png"), np.full(shape, 9, np.uint8))
    sequence = Folder.create(path=tmp_path, scale=0.5).open()
    assert [frame.image.shape for frame in sequence] == [(20, 30), (30, 20)]
    assert sequence.origin.sizes == ((20, 30), (30, 20))


@pytest.mark.parametrize("scale", [0.0, -0.5, 17.0, float("nan"), float("inf"), "half", None])
def test_scales_that_are_none(scale, tmp_path):
    with pytest.raises(ValidationError, match="scale"):
        Tum.create(path=tmp_path, scale=scale)


@pytest.mark.parametrize("scale", [0.1, 1e-9])
def test_frames_that_would_be_too_small(spot, scale):
    params, _ = spot
    with pytest.raises(DatasetError, match=rf"spot: `scale` {scale:g} .* 160x120; .* 16 pixels"):
        Folder.create(**params, scale=scale).open()


def test_frames_that_would_be_too_large(tmp_path):
    assert cv2.imwrite(str(tmp_path / "0.png"), np.zeros((1024, 1024), np.uint8))
    with pytest.raises(DatasetError, match=r"`scale` 16 .*16384x16384 .*1024x1024; .* 16 pixels .* 67,108,864 "):
        Folder.create(path=tmp_path, scale=16.0).open()
