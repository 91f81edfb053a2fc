"""Place recognition: rankings made by hand, revisits of known poses, and pictures that come back."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from memory_sequence import CodedInMemory, FunctionCodec, MemorySequence, context, textured
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera, Trajectory
from codecbench.plugins.evaluators.place_recognition import (
    PlaceRecognition,
    average_precision,
    recall,
    revisits_of,
)

CAMERA = Camera(320, 240, 260.0, 262.0, 158.5, 121.0)


@pytest.mark.parametrize(
    ("relevant", "first", "among_five", "precision"),
    [
        ([4], 1.0, 1.0, 1.0),
        ([7], 0.0, 1.0, 1 / 2),
        ([4, 9], 1.0, 1.0, (1 / 1 + 2 / 3) / 2),
        ([2, 0], 0.0, 1.0, (1 / 4 + 2 / 6) / 2),
        ([0], 0.0, 0.0, 1 / 6),
        ([4, 50], 1.0, 1.0, 1 / 2),  # a frame that is not ranked counts 0
        ([50], 0.0, 0.0, 0.0),
    ],
)
def test_scores_of_a_ranking_made_by_hand(
    relevant: list[int], first: float, among_five: float, precision: float
) -> None:
    ranking, places = np.array([4, 7, 9, 2, 8, 0]), np.array(relevant)
    assert recall(ranking, places, 1) == first
    assert recall(ranking, places, 5) == among_five
    assert average_precision(ranking, places) == pytest.approx(precision)


def test_an_empty_ranking_finds_nothing() -> None:
    nothing = np.empty(0, np.int64)
    assert recall(nothing, np.array([1]), 5) == average_precision(nothing, np.array([1])) == 0.0


def poses_at(x: list[float], yaw_deg: list[float]) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(x), 1, 1))
    poses[:, 0, 3] = x
    poses[:, :3, :3] = Rotation.from_rotvec(np.radians(yaw_deg)[:, None] * [0.0, 1.0, 0.0]).as_matrix()
    return poses


def test_a_revisit_is_near_in_place_and_view_and_far_in_time() -> None:
    poses = poses_at([0.0, 0.0, 0.4, 0.6, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0, 29.0, 31.0, 0.0])
    poses[6] = np.nan
    stamps_s = np.array([0.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0])
    assert revisits_of(0, poses, stamps_s, 0.5, 30.0, 5.0).tolist() == [2, 4]
    assert revisits_of(0, poses, stamps_s, 0.7, 40.0, 0.0).tolist() == [0, 1, 2, 3, 4, 5]
    assert revisits_of(4, poses, stamps_s, 0.5, 30.0, 5.0).tolist() == [0]  # earlier ones too
    assert revisits_of(6, poses, stamps_s, 0.5, 30.0, 1.0).tolist() == []


def there_and_back() -> MemorySequence:
    """Six places, each seen a second time from nearly the same spot, 2 s later."""
    pictures = [textured(240, 320, seed) for seed in range(6)]
    again = [np.roll(picture, 2, axis=1) for picture in pictures]
    places = [5.0 * number for number in range(6)]
    poses = poses_at([*places, *(place + 0.1 for place in places)], [0.0] * 12)
    stamps_s = np.r_[0.1 * np.arange(6), 2.0 + 0.1 * np.arange(6)]
    sequence = MemorySequence([*pictures, *again], CAMERA, Trajectory(stamps_s, poses))
    sequence.timestamps_s = stamps_s
    return sequence


def measured(sequence: MemorySequence, folder: Path, codec: FunctionCodec | None = None) -> dict[str, list[float]]:
    found = PlaceRecognition.create(gap_s=1.0).evaluate(CodedInMemory(sequence, codec), context(folder))
    by_name: dict[str, list[float]] = {metric.name: [] for metric in PlaceRecognition.metrics}
    for measurement in found:
        by_name[measurement.metric].append(measurement.value)
    return by_name


@pytest.mark.thorough
def test_places_that_come_back_are_found(tmp_path: Path) -> None:
    assert measured(there_and_back(), tmp_path) == {
        "recall_at_1": [1.0] * 12, "recall_at_5": [1.0] * 12, "average_precision": [1.0] * 12
    }  # fmt: skip


@pytest.mark.thorough
def test_pictures_of_nothing_find_nothing(tmp_path: Path) -> None:
    found = measured(there_and_back(), tmp_path, FunctionCodec(np.zeros_like))
    assert found["average_precision"] == [0.0] * 12
    assert found["recall_at_5"] == [0.0] * 12


@pytest.mark.thorough
def test_pictures_of_other_places_find_those(tmp_path: Path) -> None:
    """Each decoded picture shows the place after its own: the one that is looked for comes later in the ranking."""
    sequence = there_and_back()
    order = {image.tobytes(): number for number, image in enumerate(sequence.images)}

    def wrong(image: Image) -> Image:
        return sequence.images[(order[image.tobytes()] + 1) % 6]

    found = measured(sequence, tmp_path, FunctionCodec(wrong))
    assert found["recall_at_1"] == [0.0] * 12
    assert max(found["average_precision"]) <= 0.5


@pytest.mark.thorough
def test_frames_without_a_revisit_have_no_values(tmp_path: Path) -> None:
    sequence = there_and_back()
    assert sequence.ground_truth is not None
    sequence.ground_truth.world_from_camera[3, 0, 3] = 1000.0
    evaluator = PlaceRecognition.create(gap_s=1.0)
    missing = {
        m.frame: m.reason for m in evaluator.evaluate(CodedInMemory(sequence), context(tmp_path)) if math.isnan(m.value)
    }
    assert missing.keys() == {3, 9}
    assert all(missing.values())


def test_a_sequence_without_camera_truth_or_revisits_is_unsupported(tmp_path: Path) -> None:
    sequence = there_and_back()
    for lacking, words in (
        (MemorySequence(sequence.images, None, sequence.ground_truth), "no camera"),
        (MemorySequence(sequence.images, CAMERA, None), "no ground truth"),
    ):
        with pytest.raises(Unsupported, match=words):
            measured(lacking, tmp_path)
    with pytest.raises(Unsupported, match=r"memory .* 5 s apart"):
        list(PlaceRecognition.create().evaluate(CodedInMemory(sequence), context(tmp_path)))
