"""The default sequence: its path, its truth, its pictures, its cache."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from itertools import pairwise

import cv2
import numpy as np
import pytest
from project import GOLDEN
from pydantic import ValidationError

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import gray_from_image, png_bytes
from codecbench.plugins.datasets.files import read_image_file
from codecbench.plugins.datasets.synthetic import rendered, textures
from codecbench.plugins.datasets.synthetic.dataset import (
    READ_NOISE,
    SHOT_NOISE,
    Synthetic,
    _renderer,
    expose_and_digitize,
    room_camera,
)
from codecbench.plugins.datasets.synthetic.paths import FRAME_RATE_HZ, LOOP_S, HandheldPath
from codecbench.plugins.datasets.synthetic.rendered import FrameStore
from codecbench.plugins.datasets.synthetic.room import HALF_X, HALF_Y, HEIGHT

PICTURES = GOLDEN / "synthetic"


@pytest.fixture(autouse=True)
def own_cache(tmp_path, monkeypatch):
    """Of frames; that of kernels is everybody's."""
    monkeypatch.setattr(rendered, "cache_folder", lambda: tmp_path / "cache")
    return tmp_path / "cache"


def small(**values):
    return Synthetic.create(**{"width": 96, "height": 72, **values}).open()


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip((np.trace(a[:3, :3].T @ b[:3, :3]) - 1) / 2, -1, 1)))


# The path


def test_ground_truth_is_the_path_at_the_frames_times():
    sequence = small(frames=50, start=10, stop=40, stride=7, seed=3, speed=1.3)
    path = HandheldPath(3, 1.3)
    assert len(sequence) == 5
    np.testing.assert_allclose(sequence.timestamps_s, np.arange(10, 40, 7) / 30, rtol=0, atol=1e-15)
    for time_s, pose in zip(sequence.timestamps_s, sequence.ground_truth.world_from_camera, strict=True):
        np.testing.assert_array_equal(pose, path.world_from_camera(float(time_s)))
    assert sequence.frame_rate_hz == pytest.approx(30 / 7)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_path_is_rigid_smooth_and_inside_the_room(seed):
    path = HandheldPath(seed)
    poses = np.array([path.world_from_camera(k / FRAME_RATE_HZ) for k in range(400)])
    rotations, centers = poses[:, :3, :3], poses[:, :3, 3]
    np.testing.assert_allclose(rotations @ rotations.transpose(0, 2, 1), np.tile(np.eye(3), (400, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(rotations), 1, atol=1e-12)
    assert (np.abs(centers) < [HALF_X - 0.8, HALF_Y - 0.8, HEIGHT - 0.7]).all()
    speeds = np.linalg.norm(np.diff(centers, axis=0), axis=1) * FRAME_RATE_HZ
    turns = np.array([angle_deg(a, b) for a, b in pairwise(poses)]) * FRAME_RATE_HZ
    assert speeds.min() > 0.4
    assert speeds.max() < 1.2
    assert turns.max() < 60
    accelerations = np.linalg.norm(np.diff(centers, 2, axis=0), axis=1) * FRAME_RATE_HZ**2
    assert accelerations.max() < 3.0


def test_the_loop_returns_and_sees_its_beginning_again_for_two_seconds():
    path = HandheldPath(0)
    gaps = []
    for k in range(60):
        first, again = path.world_from_camera(k / 30), path.world_from_camera(k / 30 + LOOP_S)
        gaps.append(np.linalg.norm(first[:3, 3] - again[:3, 3]))
        assert angle_deg(first, again) < 3.0
    assert 0.002 < np.mean(gaps) < 0.05
    assert max(gaps) < 0.08
    half = path.world_from_camera(LOOP_S / 2)
    assert np.linalg.norm(half[:3, 3] - path.world_from_camera(0)[:3, 3]) > 2.0


def test_it_moves_sideways_enough_to_start_a_map_at_once():
    path = HandheldPath(0)
    start, later = path.world_from_camera(0), path.world_from_camera(0.5)
    sideways = start[:3, 0] @ (later[:3, 3] - start[:3, 3])
    assert abs(sideways) > 0.2


# Pictures


@pytest.mark.slow
def test_frames_are_the_same_in_another_process(tmp_path):
    sequence = small(frames=3)
    code = (
        "import sys, hashlib; from codecbench.plugins.datasets.synthetic.dataset import Synthetic;"
        "s = Synthetic.create(width=96, height=72, frames=3).open();"
        "print(s.fingerprint, *[hashlib.sha256(s.read(i).image.tobytes()).hexdigest() for i in (2, 0)])"
    )
    environment = {**os.environ, "CODECBENCH_CACHE": str(tmp_path / "other")}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment, check=True)
    own = [hashlib.sha256(sequence.read(i).image.tobytes()).hexdigest() for i in (2, 0)]
    assert done.stdout.split() == [sequence.fingerprint, *own]


@pytest.mark.thorough
def test_frames_do_not_depend_on_which_others_are_asked_for(own_cache):
    alone = small(start=7, stop=8).read(0).image
    for file in own_cache.rglob("*.rgb"):
        file.unlink()
    within = small(frames=20, stride=7).read(1).image
    np.testing.assert_array_equal(alone, within)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "change", [{"seed": 1}, {"noise": 0.5}, {"motion_blur": 0.5}, {"speed": 0.5}, {"width": 97}, {"color": "gray"}]
)
def test_every_parameter_changes_pictures_and_fingerprint(change):
    plain, changed = small(frames=5), small(**{"frames": 5, **change})
    assert plain.fingerprint != changed.fingerprint
    assert not np.array_equal(plain.read(4).image, changed.read(4).image)


def test_equal_selections_have_equal_fingerprints():
    assert small(frames=30).fingerprint == small(frames=400, stop=30).fingerprint
    assert small(frames=30).fingerprint != small(frames=31).fingerprint


def test_gray_is_the_gray_of_the_color_frame():
    gray = small(frames=2, color="gray")
    assert gray.channels == 1
    np.testing.assert_array_equal(gray.read(1).image, gray_from_image(small(frames=2).read(1).image))


@pytest.mark.parametrize("step", [25, pytest.param(1, marks=pytest.mark.slow)])
def test_every_frame_is_full_of_corners(step):
    sequence = Synthetic.create().open()
    orb = cv2.ORB_create(1000)
    for index in range(0, len(sequence), step):
        gray = gray_from_image(sequence.read(index).image)
        points = cv2.KeyPoint_convert(orb.detect(gray))
        assert len(points) >= 600, index
        occupied = {(int(x) // 160, int(y) // 120) for x, y in points}
        assert len(occupied) >= 11, index


@pytest.mark.parametrize("index", [0, 77, 160, 251, 333])
def test_motion_in_the_pictures_is_that_of_the_ground_truth(index):
    sequence = Synthetic.create().open()
    first, second = (gray_from_image(sequence.read(k).image) for k in (index, index + 1))
    truth = sequence.ground_truth.world_from_camera
    points = cv2.goodFeaturesToTrack(first, 400, 0.01, 8).reshape(-1, 2)
    moved, found, _ = cv2.calcOpticalFlowPyrLK(first, second, points, None, winSize=(15, 15))
    c = sequence.camera
    _, depth = _renderer(c.width, c.height).visible(truth[index])
    z = depth[np.rint(points[:, 1]).astype(int), np.rint(points[:, 0]).astype(int)]
    rays = np.column_stack([(points[:, 0] - c.cx) / c.fx, (points[:, 1] - c.cy) / c.fy, np.ones(len(points))])
    second_from_first = np.linalg.inv(truth[index + 1]) @ truth[index]
    seen = (rays * z[:, None]) @ second_from_first[:3, :3].T + second_from_first[:3, 3]
    expected = seen[:, :2] / seen[:, 2:] * [c.fx, c.fy] + [c.cx, c.cy]
    errors = np.linalg.norm(moved - expected, axis=1)[found.ravel() == 1]
    motion = np.linalg.norm(expected - points, axis=1)
    assert len(errors) > 300
    assert np.median(motion) > 1.5
    assert np.median(errors) < 0.15


def test_the_end_looks_like_the_beginning_and_nothing_else_does():
    sequence = Synthetic.create().open()
    orb, matcher = cv2.ORB_create(800), cv2.BFMatcher(cv2.NORM_HAMMING)

    def described(index):
        return orb.detectAndCompute(gray_from_image(sequence.read(index).image), None)[1]

    def alike(a, b):
        pairs = matcher.knnMatch(a, b, k=2)
        return sum(best.distance < 0.75 * second.distance for best, second in pairs)

    start = described(10)
    again = alike(start, described(350))
    others = [alike(start, described(index)) for index in (90, 140, 180, 220, 260)]
    assert again > 250
    assert max(others) < again / 5


def test_a_long_exposure_blurs():
    def sharpness(blur):
        image = Synthetic.create(noise=0.0, motion_blur=blur, start=120, stop=121).open().read(0).image
        return cv2.Laplacian(gray_from_image(image), cv2.CV_64F).var()

    assert sharpness(1.0) < 0.75 * sharpness(0.0)


@pytest.mark.parametrize("index", [0, 130, 260])
def test_pictures_are_those_of_this_version(index):
    """Set CODECBENCH_REGENERATE_GOLDEN to write them anew; raise the dataset's version when they change."""
    file = PICTURES / f"version{Synthetic.version}-{index:03d}.png"
    image = Synthetic.create(width=160, height=120, frames=300).open().read(index).image
    if os.environ.get("CODECBENCH_REGENERATE_GOLDEN"):
        PICTURES.mkdir(parents=True, exist_ok=True)
        file.write_bytes(png_bytes(image))
    difference = np.abs(read_image_file(file).astype(int) - image)
    assert difference.max() <= 2
    assert (difference > 0).mean() < 0.01


def test_noise_has_the_stated_deviation(rng):
    light = np.full((400, 500, 3), 120.0, np.float32)
    clean, noisy = (
        expose_and_digitize(light, 0.0, rng).astype(float),
        expose_and_digitize(light, 2.0, rng).astype(float),
    )
    middle = (slice(180, 220), slice(220, 280))
    assert clean[middle].mean() == pytest.approx(120, abs=1)
    expected = np.sqrt(4 * (READ_NOISE**2 + SHOT_NOISE * 120) + 1 / 12)
    assert (noisy - clean)[middle].std() == pytest.approx(expected, rel=0.05)


def test_the_camera_keeps_its_field_of_view_at_every_size():
    assert room_camera(640, 480).fx == 525.0
    assert room_camera(640, 480).cx == 319.5
    assert room_camera(320, 240).fx / 320 == room_camera(640, 480).fx / 640


# The cache


def test_frames_come_from_the_cache_and_damaged_ones_are_made_again(own_cache):
    sequence = small(frames=2)
    image = sequence.read(1).image
    (file,) = own_cache.rglob("000001.rgb")
    whole = file.read_bytes()
    store = FrameStore(file.parent, (72, 96, 3))
    np.testing.assert_array_equal(store.load(1), image)
    for damaged in (b"", whole[:40], whole[:-1], whole + b"x", whole[:500] + bytes([whole[500] ^ 1]) + whole[501:]):
        file.write_bytes(damaged)
        assert store.load(1) is None
        np.testing.assert_array_equal(sequence.read(1).image, image)
        assert file.read_bytes() == whole


def test_frames_are_the_callers_own():
    sequence = small(frames=1)
    first = sequence.read(0).image
    kept = first.copy()
    first[:] = 0
    np.testing.assert_array_equal(sequence.read(0).image, kept)


def test_a_cache_that_cannot_be_written_costs_only_time(tmp_path, monkeypatch):
    expected = small(frames=1).read(0).image
    (tmp_path / "in the way").write_text("a file where the folder should be")
    monkeypatch.setattr(rendered, "cache_folder", lambda: tmp_path / "in the way")
    np.testing.assert_array_equal(small(frames=1).read(0).image, expected)


def test_writers_at_the_same_time_do_not_disturb_each_other(tmp_path, rng):
    from concurrent.futures import ThreadPoolExecutor

    image = rng.integers(0, 256, (72, 96, 3), dtype=np.uint8)
    store = FrameStore(tmp_path / "store", image.shape)

    def write_and_read(_):
        store.save(5, image)
        return np.array_equal(store.load(5), image)

    with ThreadPoolExecutor(8) as pool:
        assert all(pool.map(write_and_read, range(200)))
    assert [file.name for file in store.folder.iterdir()] == ["000005.rgb"]


# What is wrong


@pytest.mark.parametrize(
    ("values", "pattern"),
    [
        ({"frames": 10, "stop": 11}, "stop .* 11,.* 10 frames"),
        ({"frames": 10, "start": 10}, r"start .* 10,.*frames \(10\)"),
        ({"frames": 10, "start": 5, "stop": 5}, r"start .* 5,.* stop \(5\)"),
    ],
)
def test_a_selection_that_is_not_there_is_refused(values, pattern):
    with pytest.raises(DatasetError, match=f"^synthetic.*: {pattern}"):
        small(**values)


@pytest.mark.parametrize("values", [{"stride": 0}, {"start": -1}, {"speed": 0.0}, {"noise": -1.0}, {"widht": 3}])
def test_parameters_out_of_range_are_refused(values):
    with pytest.raises(ValidationError):
        Synthetic.create(**values)


def test_an_index_out_of_range_is_refused():
    for index in (-1, 2):
        with pytest.raises(DatasetError, match=r"not in 0\.\.1"):
            small(frames=2).read(index)


def test_a_missing_photograph_is_named(monkeypatch):
    monkeypatch.setitem(textures.PHOTOGRAPH_FILES, "moon", "no_such_photograph.png")
    textures.photographs_digest.cache_clear()
    try:
        with pytest.raises(DatasetError, match=r"such_photograph\.png "):
            small(frames=1)
    finally:
        textures.photographs_digest.cache_clear()
