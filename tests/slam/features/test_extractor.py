from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rendered_scenes import CAMERA, Room, looking

from codecbench.slam.features.corner_kernels import list_corners, score_corners
from codecbench.slam.features.extractor import FeatureExtractor
from codecbench.slam.features.orb_kernels import (
    blur_level,
    describe_patches,
    find_corners,
    orient_patches,
    select_evenly,
)
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.options import Options

pytestmark = pytest.mark.thorough

IMAGE = Room().image(looking((0.0, 0.0, -1.0), 0.2, 0.1))


@pytest.mark.parametrize("threshold", [7, 20])
def test_corners_and_scores_are_those_of_opencv(threshold: int, rng: np.random.Generator) -> None:
    noisy = np.clip(IMAGE + rng.normal(0.0, 8.0, IMAGE.shape), 0, 255).astype(np.uint8)
    for image in (noisy, noisy[:37, :53].copy(), noisy[:6, :9].copy(), noisy[:9, :2].copy()):
        scores = np.empty_like(image)
        score_corners(image, scores)
        corners, found = list_corners(scores, threshold)
        keypoints = cv2.FastFeatureDetector.create(threshold, True).detect(image)
        assert [tuple(corner) for corner in corners.tolist()] == [k.pt for k in keypoints]
        assert (found - 1.0).tolist() == [k.response for k in keypoints]
        assert len(keypoints) > 0 or image.size < 100


def test_corners_follow_a_shift_below_a_pixel(rng: np.random.Generator) -> None:
    """Of corners of many angles: where they are found moves as they do, not from pixel to pixel."""
    shifts = np.arange(0.0, 1.0, 0.125)
    strayed = np.array([track for scene in rng.spawn(4) for track in _strayed(scene, shifts)])
    assert len(strayed) > 20
    assert strayed.std() < 0.12  # a whole pixel's is 0.29, that of a quarter alone 0.07
    assert np.abs(strayed.mean(axis=0)).max() < 0.06


def _strayed(rng: np.random.Generator, shifts: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """How far each corner is found (shifts,), along x, from where it was found on average plus its shift."""
    starts, spreads = rng.uniform(0.0, 2.0 * np.pi, 9), rng.uniform(1.05, 1.9, 9)
    grays, tracks = rng.choice([30.0, 170.0, 230.0], 9), []
    for shift in shifts:
        fine = np.full((120 * 16, 160 * 16), 90.0, np.float32)
        for k in range(9):
            tip = 16.0 * np.array([35.5 + 45 * (k % 3) + shift, 30.5 + 30 * (k // 3)]) - 0.5
            sides = [16.0 * 9.0 * np.array([np.cos(a), np.sin(a)]) for a in (starts[k], starts[k] + spreads[k])]
            corners = np.rint(256 * np.array([tip, tip + sides[0], tip + sides[1]])).astype(np.int32)
            cv2.fillPoly(fine, [corners], float(grays[k]), shift=8)
        seen = cv2.resize(cv2.GaussianBlur(fine, (0, 0), 0.6 * 16), (160, 120), interpolation=cv2.INTER_AREA)
        image = np.rint(seen).astype(np.uint8)
        pixels, offsets = find_corners(image, 200, np.empty_like(image))
        assert np.abs(offsets).max() <= 0.375
        tracks.append(pixels + offsets - [shift, 0.0])
    found = []
    for place in tracks[0]:
        nearest = [places[np.abs(places - place).max(axis=1).argmin()] for places in tracks]
        if np.abs(np.array(nearest) - place).max() < 1.5:
            found.append(np.array(nearest)[:, 0] - np.mean(nearest, axis=0)[0])
    return found


@pytest.mark.parametrize("shape", [(240, 320), (37, 53), (4, 40), (40, 4)])
def test_smoothing_is_that_of_opencv_but_for_rounding(shape: tuple[int, int], rng: np.random.Generator) -> None:
    image = IMAGE[: shape[0], : shape[1]].copy()
    image[::3, ::3] = rng.integers(0, 256, image[::3, ::3].shape)
    difference = _blurred(image).astype(int) - cv2.GaussianBlur(image, (7, 7), 2.0)
    assert np.abs(difference).max() <= 2
    assert abs(difference.mean()) < 0.1
    assert (_blurred(np.full(shape, 255, np.uint8)) == 255).all()


@pytest.mark.parametrize("width", [4, 31, 32, 33, 64, 75])
def test_smoothing_is_two_rounded_weighted_means(width: int, rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (9, width)).astype(np.uint8)
    gaussian = np.exp(-0.5 * (np.arange(-3, 4) / 2.0) ** 2)
    weights = np.rint(256.0 * gaussian / gaussian.sum()).astype(int)
    weights[3] += 256 - weights.sum()
    expected = image.astype(int)
    for _ in range(2):  # along the columns, then along the rows
        padded = np.pad(expected, ((3, 3), (0, 0)), mode="reflect")
        expected = ((sum(w * padded[k : k + len(expected)] for k, w in enumerate(weights)) + 128) // 256).T
    assert np.array_equal(_blurred(image), expected)


def test_descriptors_and_angles_agree_with_opencv(rng: np.random.Generator) -> None:
    corners = rng.integers([25, 25], [295, 215], (200, 2))
    angles, ours = _angles(IMAGE, corners), np.empty((len(corners), 32), np.uint8)
    describe_patches(cv2.GaussianBlur(IMAGE, (7, 7), 2.0), corners, angles, ours)
    keypoints = [
        cv2.KeyPoint(float(x), float(y), 31.0, float(np.degrees(a)) % 360.0, 1.0, 0, i)
        for i, ((x, y), a) in enumerate(zip(corners, angles, strict=True))
    ]
    kept, theirs = cv2.ORB_create(500).compute(IMAGE, keypoints)
    bits = [int(np.unpackbits(ours[k.class_id] ^ row).sum()) for k, row in zip(kept, theirs, strict=True)]
    assert len(bits) > 150
    assert max(bits) <= 4  # a test point on the edge between two pixels may round the other way
    assert np.mean(bits) < 1.0


def test_orientation_is_that_of_the_intensity_centroid(rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, (60, 70)).astype(np.uint8)
    corners = rng.integers([19, 19], [51, 41], (20, 2))
    v, u = np.mgrid[-15:16, -15:16]
    inside = np.abs(u) <= np.floor(np.sqrt(15.0**2 - v**2) + 0.5)
    for (x, y), angle in zip(corners, _angles(image, corners), strict=True):
        patch = image[y - 15 : y + 16, x - 15 : x + 16] * inside.astype(int)
        assert angle == pytest.approx(np.arctan2(float((v * patch).sum()), float((u * patch).sum())), rel=1e-14)


def test_orientation_follows_a_turned_image() -> None:
    center = np.array([[160, 120]])
    turn = cv2.getRotationMatrix2D((160.0, 120.0), 40.0, 1.0)
    smooth = cv2.GaussianBlur(IMAGE, (0, 0), 3.0)
    turned = cv2.warpAffine(smooth, turn, (320, 240))
    change = float(_angles(smooth, center)[0] - _angles(turned, center)[0])
    assert abs(np.angle(np.exp(1j * (change - np.radians(40.0))))) < np.radians(6.0)


def test_selection_is_even_bounded_and_in_order() -> None:
    x, y = np.meshgrid(np.arange(30, 290), np.arange(30, 210))
    corners = np.column_stack([x.ravel(), y.ravel()]).astype(np.int64)
    scores = np.where(corners[:, 0] < 160, 100, 10).astype(np.uint8)
    kept = select_evenly(corners, scores, 7, 300, 240, 320, 19)
    assert len(kept) == 300
    assert (np.diff(kept) > 0).all()
    left = int((corners[kept, 0] < 160).sum())
    assert 110 < left < 190  # strong responses on one side do not starve the other
    strong = select_evenly(corners, scores, 20, 300, 240, 320, 19)
    assert len(strong) == 300
    assert (corners[strong, 0] < 160).all()


def test_the_number_of_features_is_kept_and_the_extraction_repeats() -> None:
    extractor = FeatureExtractor(CAMERA, Options(features=500))
    first, second = extractor.extract(IMAGE), extractor.extract(IMAGE)
    assert 450 <= len(first) <= 500
    assert np.array_equal(first.pixels, second.pixels)
    assert np.array_equal(first.descriptors, second.descriptors)
    assert sorted(first.cell_members.tolist()) == list(range(len(first)))


def test_an_image_does_not_leave_traces_in_the_next_one() -> None:
    extractor, other = FeatureExtractor(CAMERA, Options()), np.ascontiguousarray(IMAGE[::-1])
    expected = FeatureExtractor(CAMERA, Options()).extract(other)
    first = extractor.extract(IMAGE)
    kept = first.descriptors.copy()
    assert np.array_equal(extractor.extract(other).descriptors, expected.descriptors)
    assert np.array_equal(first.descriptors, kept)


def test_features_are_made_of_keypoints_once_the_lens_is_known() -> None:
    lens = Camera(320, 240, 260.0, 262.0, 158.5, 121.0, (-0.3, 0.1, 0.0, 0.0))
    plain, bent = FeatureExtractor(CAMERA, Options()), FeatureExtractor(lens, Options())
    found = plain.find(IMAGE)
    assert found.size == (320, 240)
    assert (found.pixels >= 0.0).all()
    expected, features = bent.extract(IMAGE), bent.features_of(found)
    for name in ("pixels", "octaves", "angles", "descriptors", "cell_starts", "cell_members"):
        assert np.array_equal(getattr(features, name), getattr(expected, name))
    assert not np.array_equal(features.pixels, found.pixels)


def test_a_black_image_and_a_tiny_one_have_no_features() -> None:
    assert len(FeatureExtractor(CAMERA, Options()).extract(np.zeros((240, 320), np.uint8))) == 0
    tiny = Camera(20, 12, 20.0, 20.0, 10.0, 6.0)
    assert len(FeatureExtractor(tiny, Options()).extract(np.zeros((12, 20), np.uint8))) == 0


def test_coarse_levels_lie_where_fine_ones_do(rng: np.random.Generator) -> None:
    """Dots are found at their centres on every level, on average: levels are not shifted against each other."""
    columns, rows = np.meshgrid(np.arange(80.0, 250.0, 28.0), np.arange(80.0, 170.0, 28.0))
    centers = np.column_stack([columns.ravel(), rows.ravel()]) + rng.uniform(-4.0, 4.0, (columns.size, 2))
    x, y = np.meshgrid(np.arange(320.0), np.arange(240.0))
    image = np.full(x.shape, 20.0)
    for column, row in centers:
        image += 200.0 * np.exp(-((x - column) ** 2 + (y - row) ** 2) / (2 * 2.5**2))
    found = FeatureExtractor(CAMERA, Options(features=400)).extract(image.astype(np.uint8))
    for octave in (0, 3, 5, 7):
        chosen = found.pixels[found.octaves == octave]
        offsets = chosen[:, None] - centers[None]
        nearest = offsets[np.arange(len(chosen)), np.linalg.norm(offsets, axis=2).argmin(axis=1)]
        assert len(chosen) >= 8
        assert np.abs(nearest.mean(axis=0)).max() < 0.25 * 1.2**octave


def _blurred(image: np.ndarray) -> np.ndarray:
    blurred = np.empty_like(image)
    blur_level(image, blurred)
    return blurred


def _angles(image: np.ndarray, corners: np.ndarray) -> np.ndarray:
    angles = np.empty(len(corners))
    orient_patches(image, corners, angles)
    return angles
