"""Named worlds: their parameters, paths, truth and places."""

from __future__ import annotations

import hashlib
import json
import re
from itertools import pairwise
from math import pi

import cv2
import numpy as np
import pytest
from plain_room import walls
from pydantic import ValidationError

from codecbench.core.contracts.image import gray_from_image
from codecbench.plugins.datasets.synthetic import rendered
from codecbench.plugins.datasets.synthetic.dataset import Synthetic, SyntheticParams
from codecbench.plugins.datasets.synthetic.paths import Route
from codecbench.plugins.datasets.synthetic.render import Renderer
from codecbench.plugins.datasets.synthetic.textures import photographs_digest
from codecbench.plugins.datasets.synthetic.worlds import places, sequence
from codecbench.plugins.datasets.synthetic.worlds.conditions import (
    Conditions,
    changing_conditions,
    interpolate_conditions,
)
from codecbench.plugins.datasets.synthetic.worlds.corridor import corridor
from codecbench.plugins.datasets.synthetic.worlds.places import place_atlas, scale_contrast
from codecbench.plugins.datasets.synthetic.worlds.presets import STREET_CORNERS_M, WORLD_NAMES, WORLDS

EVERY_WORLD = pytest.mark.parametrize("world", WORLD_NAMES)


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Of frames; that of kernels is everybody's."""
    monkeypatch.setattr(rendered, "cache_folder", lambda: tmp_path / "cache")


def small(world, **values):
    return Synthetic.create(**{"world": world, "width": 96, "height": 72, **values}).open()


@pytest.fixture
def plain_places(monkeypatch):
    """The corridor and the town have but four walls, so that they are made at once."""
    monkeypatch.setattr(places, "corridor", lambda distinctness: walls(60.0))
    monkeypatch.setattr(places, "town", lambda: walls(1000.0))
    for module, name in ((places, "_panels"), (places, "place_atlas"), (sequence, "_exposure")):
        monkeypatch.setattr(module, name, getattr(module, name).__wrapped__)  # nothing of them is kept


# Parameters


def test_the_room_without_a_world_keeps_its_identity():
    picture = {"width": 640, "height": 480, "seed": 0, "speed": 1.0, "noise": 1.0, "motion_blur": 0.25}

    def digest(value):
        return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()

    expected = digest([digest(["1", picture, photographs_digest()]), list(range(400)), 3])
    assert Synthetic.create().open().fingerprint == expected


def test_what_a_world_brings_may_be_spelled_out():
    brief = SyntheticParams(world="street")
    assert (brief.width, brief.height, brief.rate_hz, brief.severity) == (1241, 376, 10.0, 0.5)
    full = SyntheticParams(world="street", width=1241, height=376, rate_hz=10, severity=0.5, frames=brief.frames)
    assert brief == full == SyntheticParams.model_validate(brief.model_dump())
    assert SyntheticParams(world="street", severity=None) == brief
    assert SyntheticParams(world="street", width=640).width == 640


def test_the_default_length_is_one_loop_and_the_beginning_of_the_next():
    slow, fast = SyntheticParams(world="field", severity=0), SyntheticParams(world="field", severity=1)
    assert slow.frames / fast.frames == pytest.approx(22 / 7, rel=0.02)
    assert SyntheticParams(world="field", severity=0, rate_hz=30).frames == pytest.approx(2 * slow.frames, abs=1)


@pytest.mark.parametrize(
    ("values", "pattern"),
    [
        ({"world": "rom"}, r"^world\n.*'room'.*'field'"),
        ({"world": "room", "severity": 1.01}, r"^severity\n.* less .*\b1 "),
        ({"world": "room", "severity": -0.1}, r"^severity\n.* greater .*\b0 "),
        ({"world": "room", "severity": "much"}, r"^severity\n.* number"),
        ({"world": "room", "rate_hz": 0}, r"^rate_hz\n.* greater than 0 "),
        ({"world": "room", "width": 8}, r"^width\n.* equal to 16 "),
        ({"world": "room", "height": 5000}, r"^height\n.* equal to 4096 "),
        ({"world": "room", "frames": 0}, r"^frames\n.* equal to 1 "),
        ({"world": "room", "noise": 2.0}, r"\bnoise .* world room"),
        ({"world": "room", "speed": 2.0}, r"\bspeed .* world room"),
        ({"severity": 0.2}, r"\bseverity needs .*\bcorridor_loop, "),
        ({"rate_hz": 10}, r"\brate_hz needs "),
    ],
)
def test_parameters_out_of_range_are_refused(values, pattern):
    with pytest.raises(ValidationError) as caught:
        SyntheticParams(**values)
    assert re.search(pattern, str(caught.value), re.MULTILINE)


# Severity


@EVERY_WORLD
def test_severity_moves_every_condition_one_way(world):
    preset = WORLDS[world]
    steps = [preset.at(k / 8) for k in range(9)]
    assert steps[0] == preset.calm
    scaled = changing_conditions(preset.calm, preset.hard)
    assert scaled, "something must get worse"
    for name, (low, high) in scaled.items():
        values = np.array([getattr(step, name) for step in steps])
        assert values[0] == pytest.approx(low)
        assert values[-1] == pytest.approx(high)
        assert (np.diff(values) * np.sign(high - low) > 0).all(), name


def test_ratios_move_by_equal_factors_and_the_rest_by_equal_steps():
    middle = interpolate_conditions(
        Conditions(electrons=100, exposure=0.1), Conditions(electrons=10000, exposure=0.5), 0.5
    )
    assert middle.electrons == pytest.approx(1000)
    assert middle.exposure == pytest.approx(0.3)


# Paths and truth


@EVERY_WORLD
@pytest.mark.parametrize("severity", [0.0, pytest.param(1.0, marks=pytest.mark.thorough)])
def test_paths_are_rigid_smooth_and_close_their_loop(world, severity):
    preset = WORLDS[world]
    conditions = preset.at(severity)
    path = preset.path(conditions, seed=3)
    closes = path.loop_s < np.inf
    times = np.arange(0.0, path.loop_s if closes else path.end_s, 0.02)
    poses = np.array([path.world_from_camera(float(time_s)) for time_s in times])
    rotations = poses[:, :3, :3]
    np.testing.assert_allclose(
        rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (len(poses), 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(rotations), 1.0, atol=1e-12)
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    assert steps.max() < 0.02 * (conditions.speed_m_s * 1.6 + 1.5)
    turns = [np.degrees(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1))) for a, b in pairwise(rotations)]
    assert max(turns) < 5.0
    if not closes:
        assert np.ptp(poses[:, 1, 3]) < 0.1
        assert np.ptp(poses[:, 0, 3]) == pytest.approx(200.0, abs=0.5)
        return
    again = path.world_from_camera(path.loop_s)
    assert np.linalg.norm(again[:3, 3] - poses[0, :3, 3]) < 0.1 + 0.2 * conditions.tremor * preset.view_m / 1.8
    assert np.trace(again[:3, :3].T @ rotations[0]) > 1 + 2 * np.cos(np.radians(2 + 3 * conditions.tremor))


def test_a_route_with_rounded_corners_has_the_length_of_its_lines_and_arcs():
    route = Route(((0.0, 0.0), (10.0, 0.0), (10.0, 6.0), (0.0, 6.0)), 1.5)
    assert route.length_m == pytest.approx(32 - 8 * 1.5 + 2 * pi * 1.5)
    points = np.array([route.at(s) for s in np.linspace(0, route.length_m, 2001)])
    assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() < route.length_m / 2000 + 1e-9
    np.testing.assert_allclose(points[0], [5, 0], atol=1e-9)
    np.testing.assert_allclose(points[-1], [5, 0], atol=1e-9)
    np.testing.assert_allclose(
        route.at(3.5 + 1.5 * pi / 4), [10 - 1.5 + 1.5 * 0.5**0.5, 1.5 - 1.5 * 0.5**0.5], atol=1e-9
    )


def test_the_street_is_a_kilometre_long_and_keeps_to_its_lanes():
    route = Route(STREET_CORNERS_M, 7.0)
    assert route.length_m == pytest.approx(1000, abs=40)
    points = np.array([route.at(float(s)) for s in np.arange(0, route.length_m, 0.5)])
    to_street = np.minimum(np.abs((points[:, 0] + 40) % 80 - 40), np.abs((points[:, 1] + 30) % 60 - 30))
    assert to_street.max() < 4.0


@EVERY_WORLD
def test_the_truth_is_the_path_at_the_frames_times(world):
    sequence = small(world, start=3, stop=20, stride=4, rate_hz=20, seed=5)
    np.testing.assert_allclose(sequence.timestamps_s, np.arange(3, 20, 4) / 20)
    assert sequence.frame_rate_hz == 5.0
    path = WORLDS[world].path(WORLDS[world].at(0.5), 5)
    for time_s, pose in zip(sequence.timestamps_s, sequence.ground_truth.world_from_camera, strict=True):
        np.testing.assert_array_equal(pose, path.world_from_camera(float(time_s)))


@EVERY_WORLD
def test_a_sequence_knows_whether_it_sees_its_beginning_again(world):
    whole = small(world)
    assert whole.has_loop == (world not in ("straight_road", "road_behind_van"))
    assert not small(world, stop=len(whole) // 2).has_loop
    assert whole.name == f"{world}-0.5"


def test_every_setting_has_a_fingerprint_of_its_own():
    settings = (
        {}, {"severity": 0.6}, {"seed": 1}, {"rate_hz": 15}, {"width": 97}, {"stop": 5}, {"color": "gray"},
        {"calibration_error": 0.01}, {"calibration_error": -0.01},
    )  # fmt: skip
    prints = {small("room", **values).fingerprint for values in settings}
    prints |= {small("dim_room").fingerprint, Synthetic.create(width=96, height=72).open().fingerprint}
    assert len(prints) == len(settings) + 2


# Places


@pytest.mark.thorough
@EVERY_WORLD
def test_every_frame_shows_something_everywhere_and_moves_as_the_truth_says(world):
    sequence = Synthetic.create(world=world, severity=0.0, width=320, height=240, rate_hz=30).open()
    camera, conditions = sequence.camera, sequence.conditions
    renderer = Renderer(place_atlas(WORLDS[world].place, conditions.contrast, conditions.distinctness), camera)
    truth = sequence.ground_truth.world_from_camera
    for index in np.linspace(5, len(sequence) - 6, 4).astype(int):
        panels, depth = renderer.visible(truth[index])
        assert (panels >= 0).all()
        errors, motion = flow_errors(sequence, int(index), depth)
        assert len(errors) > 40
        assert np.median(errors) < 0.25 + 0.02 * np.median(motion)


@pytest.mark.usefixtures("plain_places")
def test_the_van_ahead_is_the_only_difference_and_stays_where_it_is_in_the_picture():
    alone, behind = (small(world, width=320, height=96, severity=0) for world in ("straight_road", "road_behind_van"))
    np.testing.assert_array_equal(alone.ground_truth.world_from_camera, behind.ground_truth.world_from_camera)
    for index in (3, 150):
        before, after = (gray_from_image(s.read(index).image).astype(int) for s in (alone, behind))
        rows, columns = np.nonzero(np.abs(after - before) > 12)
        middle = behind.camera.cx, behind.camera.cy
        width_px = 1.9 / (12.0 - 2.3) * behind.camera.fx
        assert np.ptp(columns) == pytest.approx(width_px, abs=3)
        assert abs(np.median(columns) - middle[0]) < 6
        assert rows.max() < middle[1] + 1.65 / (12.0 - 2.3) * behind.camera.fx + 4


@pytest.mark.usefixtures("plain_places")
def test_the_first_second_is_dark_and_hardly_moves():
    sequence = small("slow_start")
    light = [float(np.square(sequence.read(index).image / 255.0).mean()) for index in (20, 26, 34, 40)]
    assert light[0] == pytest.approx(light[1], rel=0.3)
    assert light[2] == pytest.approx(light[3], rel=0.05)
    assert light[1] < 0.1 * light[2]
    gone_m = np.linalg.norm(np.diff(sequence.ground_truth.positions_world[[0, 30, 90]], axis=0), axis=1)
    assert gone_m[0] < 0.05 < gone_m[1]


def flow_errors(sequence, index, depth):
    """Differences between optical flow to the next frame and what depth and truth predict, and the motion."""
    first, second = (gray_from_image(sequence.read(k).image) for k in (index, index + 1))
    truth, c = sequence.ground_truth.world_from_camera, sequence.camera
    points = cv2.goodFeaturesToTrack(first, 300, 0.01, 6).reshape(-1, 2)
    z = depth[np.rint(points[:, 1]).astype(int), np.rint(points[:, 0]).astype(int)]
    rays = np.column_stack([(points[:, 0] - c.cx) / c.fx, (points[:, 1] - c.cy) / c.fy, np.ones(len(points))])
    second_from_first = np.linalg.inv(truth[index + 1]) @ truth[index]
    seen = (rays * z[:, None]) @ second_from_first[:3, :3].T + second_from_first[:3, 3]
    expected = (seen[:, :2] / seen[:, 2:] * [c.fx, c.fy] + [c.cx, c.cy]).astype(np.float32)
    moved_to, found, _ = cv2.calcOpticalFlowPyrLK(
        first, second, points.reshape(-1, 1, 2), expected.reshape(-1, 1, 2).copy(), winSize=(13, 13)
    )
    inside = (found.ravel() == 1) & ((expected > 6) & (expected < [c.width - 6, c.height - 6])).all(axis=1)
    errors = np.linalg.norm(moved_to.reshape(-1, 2) - expected, axis=1)[inside]
    return errors, np.linalg.norm(expected - points, axis=1)[inside]


@pytest.mark.slow
def test_a_repetitive_corridor_has_bays_alike():
    """The walls of neighbouring bays, which differ by their light alone where distinctness is 0."""

    def alike(distinctness):
        panels = corridor(distinctness)
        walls = [panel.texture.mean(axis=2) for panel in panels if panel.texture.shape == panels[0].texture.shape]
        return np.corrcoef(walls[0].ravel(), walls[1].ravel())[0, 1]

    assert alike(0.0) > 0.9
    assert alike(1.0) < 0.75


def test_fading_keeps_colors_and_scales_contrast(rng):
    from codecbench.plugins.datasets.synthetic.scene import Panel

    texture = rng.integers(60, 190, (40, 50, 3), dtype=np.uint8)
    panel = Panel(np.zeros(3), np.array([1.0, 0, 0]), np.array([0, 0, -1.0]), texture)
    (faint,) = scale_contrast([panel], 0.25)
    np.testing.assert_allclose(faint.texture.mean(axis=(0, 1)), texture.mean(axis=(0, 1)), atol=0.2)
    assert faint.texture.std() == pytest.approx(0.25 * texture.std(), rel=0.02)
    glowing = Panel(panel.corner, panel.right, panel.down, texture, glows=True)
    assert scale_contrast([glowing], 0.25)[0] is glowing
