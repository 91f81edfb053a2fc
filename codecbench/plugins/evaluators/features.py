"""The `features` evaluator measures what a codec costs a tracker that uses ORB features.

Two feature detectors are used side by side, because a codec may suit one and not the other.

Sources: Rublee, Rabaud, Konolige, Bradski, "ORB", ICCV 2011, doi:10.1109/ICCV.2011.6126544; repeatability after
Mikolajczyk et al., "A comparison of affine region detectors", IJCV 65, 2005, doi:10.1007/s11263-005-3848-x, with
mutual nearest keypoints in place of region overlap.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench import slam
from codecbench.core.contracts.evaluator import CodedFrame, CodedSequence, Context, Measurement, SequenceEvaluator
from codecbench.core.contracts.image import gray_from_image
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.view import KeypointOverlay
from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.extractor import FeatureExtractor
from codecbench.slam.features.hamming import hamming

LEVELS: Final = 8
SCALE_FACTOR: Final = 1.2
"""Pyramid of ORB as published and as ORB-SLAM uses it."""
OPENCV_BORDER_PX: Final = 31
"""OpenCV's ORB describes patches of 31 pixels and keeps its keypoints this far from the edge of the image."""
MIN_MATCHES: Final = 8
"""The fewest matches that determine a fundamental matrix."""
RANSAC_CONFIDENCE: Final = 0.999
RANSAC_ITERATIONS: Final = 2000


class FeaturesParams(Params):
    """Set how many keypoints are compared, and how far apart they may be.

    keypoints: most ORB keypoints of each detector in a frame. tolerance_px: largest shift of a keypoint that counts as
    found again, in pixels of its pyramid level. match_bits: largest Hamming distance between descriptors that match.
    inlier_px: largest distance of an inlier from its epipolar line, in pixels.
    """

    keypoints: Annotated[int, Field(ge=100, le=10_000)] = 1000
    tolerance_px: Annotated[float, Field(gt=0.0, le=20.0)] = 2.0
    match_bits: Annotated[int, Field(ge=0, le=256)] = 50
    inlier_px: Annotated[float, Field(gt=0.0, le=20.0)] = 2.0


@dataclass(frozen=True)
class FrameKeypoints:
    """Keypoints of a frame before and after coding."""

    original: Keypoints
    decoded: Keypoints
    partners: NDArray[np.int64]
    """(N,) index in `decoded` of each original keypoint, or -1 if it is not found again."""


def _metrics(prefix: str, detector: str, column_header: str) -> tuple[Metric, ...]:
    """The metrics of one detector. column_header: of the primary metric; if empty, there is no primary metric."""
    return (
        Metric(
            f"{prefix}keypoint_repeatability", "1", "higher", "share of the original's keypoints found again",
            role="task", headline=bool(column_header), label=f"keypoint repeatability, {detector}",
            column_header=column_header,
        ),
        Metric(
            f"{prefix}descriptor_distance_bits", "bits", "lower",
            "mean Hamming distance at keypoints found again",
            role="task", label=f"descriptor distance, {detector}",
        ),
        Metric(
            f"{prefix}matches_kept", "1", "higher",
            "share of the original's matches whose keypoints are found again and match",
            role="task", label=f"matches kept, {detector}",
        ),
        Metric(
            f"{prefix}inlier_ratio", "1", "higher",
            "share of decoded matches near their epipolar lines; 0 for fewer than 8",
            role="task", label=f"inlier ratio, {detector}",
        ),
    )  # fmt: skip


class Features(SequenceEvaluator[FeaturesParams]):
    """Keypoint repeatability, descriptor distance, matches kept, and inliers of a fundamental matrix.

    docs/metrics.md defines each metric. A lossless codec scores 1, 0 and 1 in the first three.
    """

    name = "features"
    version = "3"
    kernels = ("codecbench.plugins.evaluators.features", "codecbench.slam.features.orb_kernels")
    params_type = FeaturesParams
    typical_ms_per_frame = 40.0
    metrics: ClassVar[tuple[Metric, ...]] = (
        *_metrics("", "the SLAM's ORB", "features"),
        *_metrics("opencv_", "OpenCV's ORB", ""),
    )

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        count = self.params.keypoints
        detectors: dict[str, Detector] = {"": SlamDetector(count), "opencv_": OpencvDetector(count)}
        previous: dict[str, FrameKeypoints] = {}
        for position, frame in enumerate(coded):
            for prefix, detector in detectors.items():
                current = self._keypoints(frame, prefix, detector)
                values = _survival(current)
                if prefix in previous:
                    values |= self._continuity(previous[prefix], current)
                previous[prefix] = current
                for metric, value in values.items():
                    reason = value if isinstance(value, str) else None
                    number = float("nan") if isinstance(value, str) else value
                    yield Measurement(prefix + metric, number, frame=position, reason=reason)

    def marks(self, coded: CodedFrame) -> KeypointOverlay:
        """Keypoints that the SLAM's detector finds in the original, and which of them are found again."""
        current = self.keypoints(coded)
        repeated = current.partners >= 0
        share = 100.0 * np.count_nonzero(repeated) / max(1, len(repeated))
        note = f"{np.count_nonzero(repeated)} of {len(repeated)} keypoints repeated ({share:.0f} %)"
        return KeypointOverlay(current.original.places[:, :2], repeated, note)

    def keypoints(self, coded: CodedFrame) -> FrameKeypoints:
        """Keypoints that the SLAM's detector finds in the original and in the decoded frame."""
        return self._keypoints(coded, "", SlamDetector(self.params.keypoints))

    def _keypoints(self, frame: CodedFrame, prefix: str, detector: Detector) -> FrameKeypoints:
        key = ("orb_keypoints", prefix, self.params.keypoints)
        original = frame.original.cached(key, lambda image: detector.detect(gray_from_image(image)))
        decoded = detector.detect(gray_from_image(frame.decoded))
        partners = nearest_places(original.places, decoded.places, self.params.tolerance_px, SCALE_FACTOR)
        return FrameKeypoints(original, decoded, partners)

    def _continuity(self, previous: FrameKeypoints, current: FrameKeypoints) -> dict[str, float | str]:
        """Share of the matches between two frames that survives coding, and the inlier ratio of the decoded matches."""
        values: dict[str, float | str] = {}
        bits = self.params.match_bits
        before = matches(previous.original.descriptors, current.original.descriptors, bits)
        after = matches(previous.decoded.descriptors, current.decoded.descriptors, bits)
        first = np.flatnonzero(before >= 0)
        if len(first) == 0:
            values["matches_kept"] = "the original frame has no match in the previous one"
        else:
            starts, ends = previous.partners[first], current.partners[before[first]]
            both = (starts >= 0) & (ends >= 0)
            surviving = np.count_nonzero(after[starts[both]] == ends[both])
            values["matches_kept"] = float(surviving / len(first))
        matched = np.flatnonzero(after >= 0)
        pixels = previous.decoded.places[matched, :2]
        pixels_now = current.decoded.places[after[matched], :2]
        return {**values, "inlier_ratio": _inlier_ratio(pixels, pixels_now, self.params.inlier_px)}


def _survival(current: FrameKeypoints) -> dict[str, float | str]:
    """Keypoint repeatability and descriptor distance of a frame, or the reason why one of them is missing."""
    repeated = np.flatnonzero(current.partners >= 0)
    if len(current.partners) == 0:
        reason = "the original frame has no ORB keypoint"
        return {"keypoint_repeatability": reason, "descriptor_distance_bits": reason}
    repeatability = {"keypoint_repeatability": len(repeated) / len(current.partners)}
    if len(repeated) == 0:
        return {**repeatability, "descriptor_distance_bits": "no keypoint of the original frame was found again"}
    originals = current.original.descriptors[repeated]
    changed = originals ^ current.decoded.descriptors[current.partners[repeated]]
    bits = int(np.unpackbits(changed.view(np.uint8)).sum())
    return {**repeatability, "descriptor_distance_bits": bits / len(repeated)}


def _inlier_ratio(pixels: NDArray[np.float64], pixels_now: NDArray[np.float64], inlier_px: float) -> float:
    """Share of matches near their epipolar lines in both frames; 0 if there are too few for a fundamental matrix."""
    if len(pixels) < MIN_MATCHES:
        return 0.0
    # The plain method has a fixed seed of its own; OpenCV's newer ones stop with an error for a camera at rest.
    _, inliers = cv2.findFundamentalMat(
        pixels, pixels_now, cv2.FM_RANSAC, inlier_px, RANSAC_CONFIDENCE, RANSAC_ITERATIONS
    )
    return 0.0 if inliers is None else float(np.count_nonzero(inliers) / len(pixels))


@dataclass(frozen=True)
class Keypoints:
    """ORB keypoints of an image."""

    places: NDArray[np.float64]
    """(N, 3) x and y in pixels, and pyramid level."""
    descriptors: NDArray[np.uint64]
    """(N, 4)."""


class Detector(Protocol):
    """Detects keypoints; equal images give equal keypoints."""

    def detect(self, gray: NDArray[np.uint8]) -> Keypoints:
        """The keypoints of a gray image (height, width), uint8."""


class SlamDetector:
    """The feature extractor of the SLAM backend `orb`, which spreads corners evenly over the image."""

    def __init__(self, keypoints: int) -> None:
        self._options = slam.Options(features=keypoints, levels=LEVELS, scale_factor=SCALE_FACTOR)
        self._extractors: dict[tuple[int, ...], FeatureExtractor] = {}

    def detect(self, gray: NDArray[np.uint8]) -> Keypoints:
        features = self._extractor(gray.shape).extract(gray)
        return Keypoints(np.column_stack([features.pixels, features.octaves.astype(np.float64)]), features.descriptors)

    def _extractor(self, shape: tuple[int, ...]) -> FeatureExtractor:
        """The extractor for images of this shape; its camera only has to be free of distortion."""
        if shape not in self._extractors:
            height, width = shape
            camera = slam.Camera(width, height, float(width), float(width), width / 2, height / 2)
            self._extractors[shape] = FeatureExtractor(camera, self._options)
        return self._extractors[shape]


class OpencvDetector:
    """OpenCV's ORB, which keeps the strongest corners wherever they are."""

    def __init__(self, keypoints: int) -> None:
        self._orb = cv2.ORB.create(keypoints, SCALE_FACTOR, LEVELS, edgeThreshold=OPENCV_BORDER_PX)

    def detect(self, gray: NDArray[np.uint8]) -> Keypoints:
        has_room = min(gray.shape) > 2 * OPENCV_BORDER_PX
        keypoints, descriptors = self._orb.detectAndCompute(gray, None) if has_room else ((), None)
        if not keypoints:
            return Keypoints(np.empty((0, 3)), np.empty((0, 4), np.uint64))
        levels = np.array([keypoint.octave for keypoint in keypoints], dtype=np.float64)
        places = np.column_stack([cv2.KeyPoint.convert(keypoints), levels])
        return Keypoints(places, np.ascontiguousarray(descriptors).view(np.uint64))


@compiled
def matches(descriptors: Any, descriptors_now: Any, match_bits: int) -> NDArray[np.int64]:
    """For each descriptor its nearest in the other frame, or -1 if that is not mutual or is beyond `match_bits`.

    The lowest index wins among equals, in both directions.
    """
    count, count_now = len(descriptors), len(descriptors_now)
    nearest, distances = np.full(count, -1, np.int64), np.full(count, 257, np.int64)
    nearest_back, distances_back = np.full(count_now, -1, np.int64), np.full(count_now, 257, np.int64)
    for i in range(count):
        for j in range(count_now):
            bits = hamming(descriptors, i, descriptors_now, j)
            if bits < distances[i]:
                nearest[i], distances[i] = j, bits
            if bits < distances_back[j]:
                nearest_back[j], distances_back[j] = i, bits
    for i in range(count):
        if distances[i] > match_bits or nearest_back[nearest[i]] != i:
            nearest[i] = -1
    return nearest


@compiled
def nearest_places(
    places: NDArray[np.float64], others: NDArray[np.float64], tolerance_px: float, scale_factor: float
) -> NDArray[np.int64]:
    """For each place (x, y, level) its nearest among the others, or -1 if that is not mutual or is too far.

    Near enough is within `tolerance_px` at the pyramid level of the place and at most one level away. A level counts
    as much as a pixel, which distinguishes places at the same pixel.
    """
    nearest, costs = np.full(len(places), -1, np.int64), np.full(len(places), np.inf)
    nearest_back, costs_back = np.full(len(others), -1, np.int64), np.full(len(others), np.inf)
    for i in range(len(places)):
        limit = tolerance_px * scale_factor ** places[i, 2]
        for j in range(len(others)):
            across = abs(places[i, 0] - others[j, 0])
            down = abs(places[i, 1] - others[j, 1])
            levels = abs(places[i, 2] - others[j, 2])
            if across > limit or down > limit or levels > 1.0 or across * across + down * down > limit * limit:
                continue
            cost = across * across + down * down + levels
            if cost < costs[i]:
                nearest[i], costs[i] = j, cost
            if cost < costs_back[j]:
                nearest_back[j], costs_back[j] = i, cost
    for i in range(len(places)):
        if nearest[i] >= 0 and nearest_back[nearest[i]] != i:
            nearest[i] = -1
    return nearest
