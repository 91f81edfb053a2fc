"""The `place_recognition` evaluator measures whether decoded frames retrieve raw frames of the same place.

Sources: bags of binary words after Galvez-Lopez and Tardos, T-RO 28(5), 2012, doi:10.1109/TRO.2012.2197158; recall at N
as in Arandjelovic et al., "NetVLAD", CVPR 2016, doi:10.1109/CVPR.2016.572; average precision without interpolation, as
usual in retrieval, after Everingham et al.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench import slam
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import CodedSequence, Context, Measurement, SequenceEvaluator
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import Camera, FrameSequence
from codecbench.plugins.evaluators.trajectory.alignment import Poses, rotation_angles_deg, true_poses
from codecbench.slam.features.extractor import FeatureExtractor
from codecbench.slam.places.recognition import KeyframeDatabase
from codecbench.slam.places.vocabulary import BowVector, Vocabulary


class PlaceRecognitionParams(Params):
    """Set which frames show the same place.

    features: most ORB features in a frame. radius_m, angle_deg: two frames show the same place if their true poses are
    at most this far apart. gap_s: shortest time between a frame and the frames that it is compared with, in seconds.
    association_s: largest time between a frame and its ground truth, in seconds.
    """

    features: Annotated[int, Field(ge=100, le=10_000)] = 1000
    radius_m: Annotated[float, Field(gt=0.0)] = 0.5
    angle_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 30.0
    gap_s: Annotated[float, Field(ge=0.0)] = 5.0
    association_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02


@dataclass(frozen=True)
class Places:
    """The raw frames of a sequence as a database to query."""

    database: KeyframeDatabase
    timestamps_s: NDArray[np.float64]
    revisits: dict[int, NDArray[np.int64]]
    """By frame, the other frames that show its place."""

    def ranking(self, bag: BowVector, frame: int, gap_s: float) -> NDArray[np.int64]:
        """Raw frames that share a word with the bag of a frame, most similar first, except those within `gap_s`."""
        candidates, scores, _ = self.database.query(bag)
        far = np.abs(self.timestamps_s[candidates] - self.timestamps_s[frame]) >= gap_s
        candidates, scores = candidates[far], scores[far]
        return np.asarray(candidates[np.argsort(-scores, kind="stable")])


class PlaceRecognition(SequenceEvaluator[PlaceRecognitionParams]):
    """Queries a database of the raw frames with every decoded frame whose place is revisited."""

    name = "place_recognition"
    version = "2"
    params_type = PlaceRecognitionParams
    needs = frozenset({"camera", "ground_truth"})
    kernels = ("codecbench.slam",)
    typical_ms_per_frame = 15.0
    metrics: ClassVar[tuple[Metric, ...]] = (
        Metric(
            "recall_at_1", "1", "higher", "1 if the most similar raw frame shows the place, else 0",
            role="task", label="place recall at 1",
        ),
        Metric(
            "recall_at_5", "1", "higher", "1 if one of the five most similar does, else 0",
            role="task", label="place recall at 5",
        ),
        Metric(
            "average_precision", "1", "higher",
            "mean precision at the rank of each raw frame of the place; 0 without a common word",
            role="task", headline=True, label="place mean average precision", column_header="places mAP",
        ),
    )  # fmt: skip

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        sequence, camera = coded.sequence, coded.sequence.camera
        if camera is None:
            raise Unsupported(f"sequence {sequence.name} has no camera; features need its calibration")
        bags = _BagOfWords(camera, self.params.features)
        key = ("place_recognition", self.version, *self.params.model_dump().values())
        places = sequence.read(0).cached(key, lambda _: self._places(sequence, bags))
        if not any(len(others) for others in places.revisits.values()):
            limits = f"{self.params.radius_m:g} m and {self.params.angle_deg:g} degrees"
            raise Unsupported(
                f"{sequence.name} revisits no place: no two frames {self.params.gap_s:g} s apart are within "
                f"{limits} of each other; give a sequence with a loop, or change radius_m, angle_deg or gap_s"
            )
        for index, others in places.revisits.items():
            if len(others):
                ranking = places.ranking(bags.of(coded.frame(index).decoded), index, self.params.gap_s)
                yield Measurement("recall_at_1", recall(ranking, others, 1), frame=index)
                yield Measurement("recall_at_5", recall(ranking, others, 5), frame=index)
                yield Measurement("average_precision", average_precision(ranking, others), frame=index)
            else:
                reason = "no other frame shows this place"
                yield from (Measurement(m.name, math.nan, frame=index, reason=reason) for m in self.metrics)

    def _places(self, sequence: FrameSequence, bags: _BagOfWords) -> Places:
        params = self.params
        poses = true_poses(sequence, params.association_s)
        stamps_s = sequence.timestamps_s
        revisits = {
            index: revisits_of(index, poses, stamps_s, params.radius_m, params.angle_deg, params.gap_s)
            for index in range(len(sequence))
        }
        database = KeyframeDatabase(bags.words)
        if any(map(len, revisits.values())):
            for index in range(len(sequence)):
                database.add(index, bags.of(sequence.read(index).image))
        return Places(database, stamps_s, revisits)


def revisits_of(
    frame: int, poses: Poses, stamps_s: NDArray[np.float64], radius_m: float, angle_deg: float, gap_s: float
) -> NDArray[np.int64]:
    """(R,) frames at least `gap_s` from a frame whose true poses (N, 4, 4) are near its own; NaN is never near."""
    with np.errstate(invalid="ignore"):
        near = np.linalg.norm(poses[:, :3, 3] - poses[frame, :3, 3], axis=1) <= radius_m
        near &= np.abs(stamps_s - stamps_s[frame]) >= gap_s
    others = np.flatnonzero(near)
    turns = poses[others, :3, :3] @ poses[frame, :3, :3].T
    return np.asarray(others[rotation_angles_deg(turns) <= angle_deg])


def recall(ranking: NDArray[np.int64], relevant: NDArray[np.int64], first: int) -> float:
    """1 if one of the `first` frames of a ranking is relevant, else 0."""
    return float(np.isin(ranking[:first], relevant).any())


def average_precision(ranking: NDArray[np.int64], relevant: NDArray[np.int64]) -> float:
    """Mean precision at the ranks of the relevant frames; a relevant frame that is not ranked counts 0."""
    hits = np.isin(ranking, relevant)
    precisions = np.cumsum(hits) / np.arange(1, len(ranking) + 1)
    return float(precisions[hits].sum() / len(relevant))


class _BagOfWords:
    """Computes bags of words of images with the SLAM's default vocabulary."""

    def __init__(self, camera: Camera, features: int) -> None:
        sizes = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        lens = slam.Camera(*sizes, camera.distortion, camera.model)
        self._extractor = FeatureExtractor(lens, slam.Options(features=features))
        self._vocabulary = Vocabulary.load_default()
        self.words = len(self._vocabulary)

    def of(self, image: Image) -> BowVector:
        """The bag of an image, color or gray."""
        descriptors = self._extractor.extract(np.ascontiguousarray(gray_from_image(image))).descriptors
        return self._vocabulary.bow(self._vocabulary.words(descriptors).words)
