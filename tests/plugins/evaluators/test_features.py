"""Feature metrics on pictures whose keypoints move in known ways."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest
from memory_sequence import CodedInMemory, FunctionCodec, MemorySequence, context, jpeg, textured

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.image import Image
from codecbench.plugins.evaluators.features import Features, _inlier_ratio, matches, nearest_places


def moving(frames: int, height: int = 240, width: int = 320) -> list[Image]:
    """A camera that slides over a textured wall."""
    wall = textured(height, width + 6 * frames)
    return [np.ascontiguousarray(wall[:, 6 * i : 6 * i + width]) for i in range(frames)]


EACH_FINDER = pytest.mark.parametrize("finder", ["", "opencv_"], ids=["slam", "opencv"])


def measured(images: list[Image], codec: FunctionCodec, folder: Path, **params: float) -> list[Measurement]:
    coded = CodedInMemory(MemorySequence(images), codec)
    return list(Features.create(**params).evaluate(coded, context(folder)))


def values(measurements: list[Measurement], metric: str) -> list[float]:
    return [one.value for one in measurements if one.metric == metric]


@EACH_FINDER
def test_a_lossless_codec_loses_nothing(finder: str, tmp_path: Path) -> None:
    found = measured(moving(4), FunctionCodec(), tmp_path)
    assert values(found, finder + "keypoint_repeatability") == [1.0] * 4
    assert values(found, finder + "descriptor_distance_bits") == [0.0] * 4
    assert values(found, finder + "matches_kept") == [1.0] * 3
    assert all(0.8 < value <= 1.0 for value in values(found, finder + "inlier_ratio"))


def test_what_is_marked_is_what_is_measured(tmp_path: Path) -> None:
    images = moving(2)
    codec = FunctionCodec(lambda image: jpeg(image, 8))
    found = measured(images, codec, tmp_path, keypoints=500)
    (share,) = [one.value for one in found if one.metric == "keypoint_repeatability" and one.frame == 1]
    coded = CodedInMemory(MemorySequence(images), codec)
    marks = Features.create(keypoints=500).marks(coded.frame(1))
    assert 0 < share < 1
    assert marks.kept.mean() == pytest.approx(share, abs=1e-12)
    assert marks.places.shape == (len(marks.kept), 2)
    assert marks.note.startswith(f"{marks.kept.sum()} of {len(marks.kept)} keypoints repeated")


@EACH_FINDER
def test_first_frame_has_no_predecessor(finder: str, tmp_path: Path) -> None:
    found = measured(moving(3), FunctionCodec(), tmp_path)
    assert {one.frame for one in found if one.metric in (finder + "matches_kept", finder + "inlier_ratio")} == {1, 2}
    assert {one.metric for one in found} == {metric.name for metric in Features.metrics}


def test_worse_quality_is_worse_in_every_metric(tmp_path: Path) -> None:
    images = moving(4)
    means = {
        quality: {
            metric.name: np.mean(
                values(measured(images, FunctionCodec(lambda i, q=quality: jpeg(i, q)), tmp_path), metric.name)
            )
            for metric in Features.metrics
        }
        for quality in (90, 20, 3)
    }
    for finder in ("", "opencv_"):
        for name in (finder + "keypoint_repeatability", finder + "matches_kept"):
            assert means[90][name] > means[20][name] > means[3][name]
        name = finder + "descriptor_distance_bits"
        assert means[90][name] < means[20][name]


def test_results_repeat_to_the_last_bit(tmp_path: Path) -> None:
    images = moving(3)
    codec = FunctionCodec(lambda image: jpeg(image, 10))
    cv2.setRNGSeed(1)
    first = measured(images, codec, tmp_path)
    cv2.setRNGSeed(99)
    assert measured(images, codec, tmp_path) == first


@EACH_FINDER
def test_a_picture_with_nothing_in_it_scores_nothing(finder: str, tmp_path: Path) -> None:
    found = measured(moving(3), FunctionCodec(np.zeros_like), tmp_path)
    assert values(found, finder + "keypoint_repeatability") == [0.0] * 3
    assert values(found, finder + "matches_kept") == [0.0] * 2
    assert values(found, finder + "inlier_ratio") == [0.0] * 2
    missing = [one for one in found if math.isnan(one.value)]
    assert {one.metric for one in missing} == {"descriptor_distance_bits", "opencv_descriptor_distance_bits"}
    assert all(one.reason for one in missing)


@EACH_FINDER
@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (31, 31), (64, 64)])
def test_originals_without_keypoints_are_missing_with_a_reason(
    shape: tuple[int, int], finder: str, tmp_path: Path
) -> None:
    found = measured([np.full(shape, 90, np.uint8)] * 2, FunctionCodec(), tmp_path)
    missing = {one.metric: one.reason for one in found if math.isnan(one.value)}
    assert "no ORB keypoint" in str(missing[finder + "keypoint_repeatability"])
    assert "no match" in str(missing[finder + "matches_kept"])
    assert values(found, finder + "inlier_ratio") == [0.0]


@EACH_FINDER
@pytest.mark.parametrize("quality", [100, 30, 5])
def test_a_camera_at_rest_is_no_special_case(quality: int, finder: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    still = textured(240, 320).astype(np.int16)
    images = [np.asarray(np.clip(still + rng.integers(-3, 4, still.shape), 0, 255), dtype=np.uint8) for _ in range(8)]
    found = measured(images, FunctionCodec(lambda image: jpeg(image, quality)), tmp_path)
    assert all(0.5 < value <= 1.0 for value in values(found, finder + "inlier_ratio"))


def test_a_shift_within_tolerance_is_found_and_one_beyond_is_not(tmp_path: Path) -> None:
    """All keypoints move by the same three pixels; the SLAM's choice of corners, cell by cell, changes with that."""
    image = textured(300, 400)

    def shifted(_: Image) -> Image:
        return np.ascontiguousarray(np.roll(image, 3, axis=1))

    near, far = (
        measured([image], FunctionCodec(shifted), tmp_path, keypoints=100, tolerance_px=tolerance_px)
        for tolerance_px in (3.5, 0.4)
    )
    for metric in ("keypoint_repeatability", "opencv_keypoint_repeatability"):
        assert values(near, metric)[0] >= 0.5
        assert values(far, metric)[0] < 0.1


def test_the_finders_are_the_slams_and_opencvs(tmp_path: Path) -> None:
    """A codec that leaves the strongest corners alone pleases OpenCV, which looks for those; the SLAM wants all."""
    image = textured(300, 400)
    corners = cv2.ORB.create(1000, edgeThreshold=31).detect(image, None)
    mask = np.zeros_like(image)
    for corner in corners:
        cv2.circle(mask, (round(corner.pt[0]), round(corner.pt[1])), 20, 1, -1)
    blurred = cv2.GaussianBlur(image, (0, 0), 3)
    kept = FunctionCodec(lambda image: np.where(mask > 0, image, blurred))
    found = measured([image], kept, tmp_path)
    assert mask.mean() < 0.95
    assert values(found, "opencv_keypoint_repeatability")[0] > values(found, "keypoint_repeatability")[0]


def brute_force_partners(costs: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Mutual nearest partners by whole matrices: an independent way to the kernels' answer."""
    costs = np.where(allowed, costs, np.inf)
    forward, back = costs.argmin(axis=1), costs.argmin(axis=0)
    mutual = (back[forward] == np.arange(len(costs))) & np.isfinite(costs.min(axis=1))
    return np.where(mutual, forward, -1)


def test_descriptor_matches_are_mutual_nearest(rng: np.random.Generator) -> None:
    first = rng.integers(0, 256, (80, 32), dtype=np.uint8)
    second = np.concatenate(
        [first[20:60] ^ (rng.random((40, 32)) < 0.1), rng.integers(0, 256, (30, 32), dtype=np.uint8)]
    )
    second = np.asarray(second, dtype=np.uint8)
    bits = np.unpackbits(first[:, None] ^ second[None], axis=2).sum(axis=2).astype(float)
    found = matches(first.view(np.uint64), second.view(np.uint64), 50)
    np.testing.assert_array_equal(
        found, brute_force_partners(bits, bits < 257) * (bits.min(axis=1) <= 50) - (bits.min(axis=1) > 50)
    )
    assert np.count_nonzero(found >= 0) >= 40


def test_place_matches_are_mutual_nearest(rng: np.random.Generator) -> None:
    places = np.column_stack([rng.uniform(0, 60, (200, 2)), rng.integers(0, 4, 200)])
    others = places[rng.permutation(200)] + np.column_stack([rng.normal(0, 1, (200, 2)), rng.integers(-1, 2, 200)])
    pixels = np.linalg.norm(places[:, None, :2] - others[None, :, :2], axis=2)
    levels = np.abs(places[:, None, 2] - others[None, :, 2])
    allowed = (pixels <= 2.0 * 1.2 ** places[:, 2][:, None]) & (levels <= 1)
    found = nearest_places(places, others, 2.0, 1.2)
    np.testing.assert_array_equal(found, brute_force_partners(pixels**2 + levels, allowed))
    assert np.count_nonzero(found >= 0) > 50


def test_inlier_ratio_of_a_known_geometry(rng: np.random.Generator) -> None:
    """Three matches in four follow two views of one scene, the rest are random."""
    points = np.column_stack([rng.uniform(-2, 2, (400, 2)), rng.uniform(4, 8, 400)])
    moved = points + np.array([0.3, 0.05, 0.1])
    pixels, pixels_now = (500 * p[:, :2] / p[:, 2:] + [320, 240] for p in (points, moved))
    pixels_now[300:] = rng.uniform(0, 640, (100, 2))
    assert _inlier_ratio(pixels, pixels_now, 1.0) == pytest.approx(0.75, abs=0.02)
    assert _inlier_ratio(pixels[:7], pixels_now[:7], 1.0) == 0.0
