"""The renderer against other ways to compute the same picture: OpenCV's projections and rays traced one by one."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from codecbench.core.contracts.sequence import Camera
from codecbench.plugins.datasets.synthetic.render import Renderer
from codecbench.plugins.datasets.synthetic.scene import Panel, box, make_atlas, place_panels, upright
from codecbench.plugins.datasets.synthetic.textures import halve, photograph, resize, scatter_patches

CAMERA = Camera(320, 240, 262.0, 258.0, 158.5, 121.0)
OFFSETS = np.array([[-1 / 3, 0.0], [0.0, 1 / 3], [1 / 3, -1 / 3]])


def looking_at(position, target):
    """world_from_camera of a camera without roll, z up."""
    forward = np.array(target, float) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = position
    return pose


def project(points_world, pose):
    """Pixels by OpenCV, which shares nothing with the renderer."""
    camera_from_world = np.linalg.inv(pose)
    rotation, _ = cv2.Rodrigues(camera_from_world[:3, :3])
    matrix = np.array([[CAMERA.fx, 0, CAMERA.cx], [0, CAMERA.fy, CAMERA.cy], [0, 0, 1.0]])
    pixels, _ = cv2.projectPoints(np.asarray(points_world, float), rotation, camera_from_world[:3, 3], matrix, None)
    return pixels.reshape(-1, 2)


def picture(panels, pose):
    return Renderer(make_atlas(panels), CAMERA).mean_of_samples(np.array([pose] * len(OFFSETS)), OFFSETS)


def test_corners_of_a_chessboard_land_where_the_camera_model_says():
    squares = np.indices((7, 10)).sum(axis=0) % 2
    board = np.kron(squares, np.ones((40, 40))).astype(np.uint8)[:, :, None] * np.full(3, 255, np.uint8)
    margin = np.full((360, 480, 3), 255, np.uint8)
    margin[40:320, 40:440] = board
    panel = upright((0.0, 1.0, 0.3), -90.0, 1.2, 0.9, margin)
    pose = looking_at(np.array([0.35, -0.6, 0.5]), (0.05, 1.0, 0.25))
    gray = np.rint(picture([panel], pose)[:, :, 1]).astype(np.uint8)
    found, corners = cv2.findChessboardCorners(gray, (9, 6))
    assert found
    corners = cv2.cornerSubPix(gray, corners, (4, 4), (-1, -1), (3, 50, 1e-4)).reshape(-1, 2)
    grid = [panel.point((80 + 40 * i) / 480, (80 + 40 * j) / 360) for j in range(6) for i in range(9)]
    expected = project(grid, pose)
    differences = corners[:, None] - expected[None]
    nearest = np.linalg.norm(differences, axis=2).argmin(axis=1)
    errors = differences[np.arange(len(corners)), nearest]
    assert len(set(nearest.tolist())) == 54
    assert np.abs(errors).max() < 0.3
    assert np.abs(errors.mean(axis=0)).max() < 0.02


def test_a_wall_looks_like_its_photograph_through_a_homography():
    photo = photograph("astronaut")
    panel = upright((0.0, 1.5, 0.0), -90.0, 1.6, 1.6, photo)
    pose = looking_at(np.array([0.5, -0.2, 0.2]), (0.0, 1.5, 0.0))
    corners = project([panel.point(s, t) for s, t in ((0, 0), (1, 0), (1, 1), (0, 1))], pose)
    texels = np.float32([[-0.5, -0.5], [511.5, -0.5], [511.5, 511.5], [-0.5, 511.5]])
    matrix = cv2.getPerspectiveTransform(texels, corners.astype(np.float32))
    large = np.diag([8.0, 8.0, 1.0]) @ np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]) @ matrix
    shift = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1.0]])
    expected = cv2.warpPerspective(photo, shift @ large, (320 * 8, 240 * 8), flags=cv2.INTER_LINEAR)
    expected = cv2.resize(expected, (320, 240), interpolation=cv2.INTER_AREA).astype(float)
    inside = cv2.warpPerspective(np.ones((512, 512), np.uint8), matrix, (320, 240)) > 0
    inside = cv2.erode(inside.astype(np.uint8), np.ones((5, 5))) > 0
    assert inside.sum() > 20_000
    error = (picture([panel], pose) - expected)[inside]
    assert 10 * np.log10(255**2 / np.mean(error**2)) > 30.0
    assert abs(error.mean()) < 0.5


def traced(panels, pose, x, y):
    """Index and depth of the first panel on the ray through a pixel, by solving for each."""
    ray = pose[:3, :3] @ [(x - CAMERA.cx) / CAMERA.fx, (y - CAMERA.cy) / CAMERA.fy, 1.0]
    best, nearest = -1, np.inf
    for index, panel in enumerate(panels):
        if panel.normal @ ray >= 0:
            continue
        depth, s, t = np.linalg.solve(np.column_stack([ray, -panel.right, -panel.down]), panel.corner - pose[:3, 3])
        if 1e-9 < depth < nearest and 0 <= s <= 1 and 0 <= t <= 1:
            best, nearest = index, depth
    return best, nearest


def cluttered(rng):
    texture = np.zeros((2, 2, 3), np.uint8)
    panels = [Panel(np.array([-3.0, 3.0, 0.0]), np.array([6.0, 0, 0]), np.array([0, -6.0, 0]), texture)]
    for _ in range(12):
        foot, size = rng.uniform((-1.5, -1.5, 0), (1.5, 1.5, 0.5)), rng.uniform(0.1, 0.8, 3)
        panels += box(tuple(foot), tuple(size), lambda *_: texture, float(rng.uniform(0, 360)))
    for _ in range(20):
        corner, right, down = rng.normal(size=(3, 3))
        panels.append(Panel(corner, right, np.cross(right, down), texture))
    return panels


@pytest.mark.thorough
def test_nearest_panel_and_its_depth_are_those_of_traced_rays(rng):
    panels = cluttered(rng)
    renderer = Renderer(make_atlas(panels), CAMERA)
    backwards = Renderer(make_atlas(panels[::-1]), CAMERA)
    compared = 0
    for _ in range(6):
        pose = looking_at(rng.uniform((-2, -2, 0.2), (2, 2, 1.8)), rng.uniform(-0.5, 0.5, 3))
        index, depth = renderer.visible(pose)
        _, again = backwards.visible(pose)
        np.testing.assert_array_equal(depth, again)
        for x, y in zip(rng.integers(320, size=60), rng.integers(240, size=60), strict=True):
            expected, distance = traced(panels, pose, x, y)
            assert depth[y, x] == pytest.approx(distance, rel=1e-9) or (expected == -1 and index[y, x] == -1)
            compared += expected >= 0
    assert compared > 150


def test_a_panel_is_seen_from_its_front_only():
    panel = upright((0, 1, 0), -90.0, 1.0, 1.0, np.full((4, 4, 3), 200, np.uint8))
    renderer = Renderer(make_atlas([panel]), CAMERA)
    assert (renderer.visible(looking_at(np.array([0.0, 0.0, 0.01]), (0, 1, 0)))[0] == 0).any()
    assert (renderer.visible(looking_at(np.array([0.0, 2.0, 0.01]), (0, 1, 0)))[0] == -1).all()
    assert (renderer.visible(looking_at(np.array([0.0, 0.0, 0.01]), (0, -1, 0)))[0] == -1).all()


def test_every_box_face_looks_outwards():
    faces = place_panels(
        box((0, 0, 0), (1, 2, 3), lambda *_: np.zeros((1, 1, 3), np.uint8), 33.0), (5.0, 1.0, 0.0), 71.0
    )
    center = np.array([5.0, 1.0, 1.5])
    assert len(faces) == 6
    for face in faces:
        assert face.normal @ (face.point(0.5, 0.5) - center) > 0.4


def test_fine_detail_far_away_becomes_its_mean_and_does_not_flicker(rng):
    noise = rng.integers(0, 256, (1024, 1024, 1), dtype=np.uint8).repeat(3, axis=2)
    panel = upright((0, 8.0, 0), -90.0, 6.0, 6.0, noise)
    seen = picture([panel], looking_at(np.array([0.0, 0.0, 0.01]), (0, 1, 0)))[60:180, 80:240, 1]
    assert abs(seen.mean() - noise.mean()) < 2.0
    assert seen.std() < 0.35 * noise.std()


def test_reductions_keep_the_mean():
    image = photograph("cat").astype(np.float32)[:300, :450]
    np.testing.assert_allclose(halve(image).mean(axis=(0, 1)), image.mean(axis=(0, 1)), rtol=1e-4)
    expected = cv2.resize(photograph("cat")[:300, :448], (224, 150), interpolation=cv2.INTER_AREA)
    assert np.abs(resize(photograph("cat")[:300, :448], 150, 224).astype(int) - expected).max() <= 1


def test_strewn_surfaces_keep_brightness_and_contrast_of_the_photograph(rng):
    gravel = photograph("gravel")[:, :, 1]
    surface = scatter_patches("gravel", 700, 900, rng, 120)[:, :, 1]
    assert surface.shape == (700, 900)
    assert abs(float(surface.mean()) - float(gravel.mean())) < 6
    assert surface.std() == pytest.approx(gravel.std(), rel=0.15)
