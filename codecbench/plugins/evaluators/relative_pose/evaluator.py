"""The `relative_pose` evaluator estimates the motion between two decoded frames from their matches."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from codecbench.core.contracts.codec import Architecture, gets_features
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import CodedSequence, Context, Measurement, SequenceEvaluator
from codecbench.core.contracts.metric import Better, Metric
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import Frame, FrameSequence
from codecbench.plugins.evaluators.relative_pose.matching import NO_KEYPOINTS, Detector, KeypointSet, Matcher
from codecbench.plugins.evaluators.relative_pose.pairs import Pair, pair_of, scene_distance_m
from codecbench.plugins.evaluators.relative_pose.two_view import (
    curve_area,
    estimate_motion,
    near_epipolar_lines,
    pose_error_deg,
)
from codecbench.plugins.evaluators.trajectory.alignment import true_poses

Share = Annotated[float, Field(gt=0.0, le=1.0)]


class RelativePoseParams(Params):
    """Set the pairs of frames, and how their keypoints are detected and matched.

    architecture: `features` refuses image codecs; otherwise motion is estimated from what a codec sends, and received
    features are used unchanged. detector: `orb` or `sift`. keypoints: most in a frame. ratio: largest ratio of the best
    descriptor distance to the second best in a match. inlier_px: MAGSAC's threshold, and the largest distance of a
    correct match from its true epipolar lines, in pixels. baselines: translations between the frames of a pair, in
    units of the scene distance; frames use them in turn. min_overlap: least share of a frame that the other
    shows. association_s: largest time between a frame and its true pose, in seconds.
    """

    architecture: Architecture = "cta"
    detector: Detector = "orb"
    keypoints: Annotated[int, Field(ge=50, le=10_000)] = 1000
    ratio: Share = 0.8
    inlier_px: Annotated[float, Field(gt=0.0, le=20.0)] = 1.5
    baselines: Annotated[tuple[Annotated[float, Field(gt=0.0, le=2.0)], ...], Field(min_length=1)] = (0.04, 0.08, 0.16)
    min_overlap: Share = 0.5
    association_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02


def _task(name: str, unit: str, better: Better, summary: str, label: str, *aggregates: str) -> Metric:
    return Metric(name, unit, better, summary, aggregates or ("mean",), role="task", label=label)


class RelativePose(SequenceEvaluator[RelativePoseParams]):
    """Evaluates pairs of a frame and a later one at a given baseline; docs/task-metrics.md says which.

    Nothing is random, so equal frames give equal values whatever the codec.
    """

    name = "relative_pose"
    version = "2"
    params_type = RelativePoseParams
    needs = frozenset({"camera", "ground_truth"})
    kernels = ("codecbench.plugins.evaluators.relative_pose",)
    typical_ms_per_frame = 25.0
    metrics: ClassVar[tuple[Metric, ...]] = (
        _task(
            "pose_error_deg", "deg", "lower",
            "larger of rotation error and translation direction error (up to sign); 180 without a motion",
            "pose error", "median", "p95",
        ),
        _task("pose_auc_5deg", "1", "higher", "max(0, 1 - pose_error_deg / 5)", "pose AUC to 5°"),
        Metric(
            "pose_auc_10deg", "1", "higher", "max(0, 1 - pose_error_deg / 10)",
            role="task", headline=True, label="pose AUC to 10°", column_header="pose AUC",
        ),
        _task("pose_auc_20deg", "1", "higher", "max(0, 1 - pose_error_deg / 20)",
              "pose AUC to 20°"),
        _task(
            "pose_inliers", "1", "higher", "matches consistent with the estimated motion, else 0",
            "pose inliers",
        ),
        Metric(
            "correct_matches", "1", "higher",
            "matches within inlier_px of their true epipolar lines in both frames",
            role="task", headline=True, label="correct matches", column_header="matches",
        ),
        _task(
            "matches_lost", "1", "lower",
            "1 - correct_matches / the raw pair's",
            "matches lost",
        ),
    )  # fmt: skip

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        sequence, sends_features = coded.sequence, gets_features(coded.codec, self.params.architecture)
        if sequence.camera is None:
            raise Unsupported(
                f"sequence {sequence.name} has no camera; the motion between frames needs its calibration"
            )
        matcher = Matcher(self.params.detector, self.params.keypoints, self.params.ratio, sequence.camera)
        pairs: dict[int, list[Pair]] = defaultdict(list)
        firsts: dict[int, KeypointSet] = {}
        for index, pair in enumerate(self._pairs(sequence, matcher)):
            if isinstance(pair, Pair):
                pairs[pair.second].append(pair)
                firsts[index] = NO_KEYPOINTS
            else:
                yield from (Measurement(m.name, math.nan, frame=index, reason=pair) for m in self.metrics)
        if not pairs:
            raise Unsupported(f"no two frames of {sequence.name} are far enough apart and overlap; see baselines")
        for index in range(len(coded)):
            if index not in firsts and index not in pairs:
                continue
            keypoints = (
                matcher.convert(coded.features(index)) if sends_features else matcher.detect(coded.frame(index).decoded)
            )
            if index in firsts:
                firsts[index] = keypoints
            for pair in pairs.pop(index, ()):
                yield from self._judge(
                    pair, firsts.pop(pair.first), keypoints, self._raw_correct(pair, sequence, matcher), matcher
                )

    def _key(self, what: str) -> tuple[object, ...]:
        """The cache key of a result for raw frames, with all that it depends on."""
        return ("relative_pose", what, self.version, *self.params.model_dump(exclude={"architecture"}).values())

    def _pairs(self, sequence: FrameSequence, matcher: Matcher) -> list[Pair | str]:
        """For each frame its pair, or why it has none. All codec settings have the same pairs."""
        camera = sequence.camera
        assert camera is not None

        def choose_pairs() -> list[Pair | str]:
            poses = true_poses(sequence, self.params.association_s)
            distance_m = scene_distance_m(sequence, poses, matcher)
            baselines, least = self.params.baselines, self.params.min_overlap
            return [
                pair_of(first, poses, camera, distance_m, baselines[first % len(baselines)], least)
                for first in range(len(sequence))
            ]

        return sequence.read(0).cached(self._key("pairs"), lambda _: choose_pairs())

    def _raw_correct(self, pair: Pair, sequence: FrameSequence, matcher: Matcher) -> int:
        """Correct matches of the pair's raw frames."""

        def keypoints(frame: Frame) -> KeypointSet:
            return frame.cached(self._key("features"), matcher.detect)

        def count_correct() -> int:
            second = keypoints(sequence.read(pair.second))
            return int(self._correct(pair, *_match_pixels(matcher, keypoints(first), second), matcher).sum())

        first = sequence.read(pair.first)
        return first.cached(self._key("correct matches"), lambda _: count_correct())

    def _correct(self, pair: Pair, first: np.ndarray, second: np.ndarray, matcher: Matcher) -> np.ndarray:
        """(M,) whether each match of pixels (M, 2) is correct."""
        return near_epipolar_lines(first, second, matcher.matrix, pair.second_from_first, self.params.inlier_px)

    def _judge(
        self, pair: Pair, first: KeypointSet, second: KeypointSet, raw_correct: int, matcher: Matcher
    ) -> Iterator[Measurement]:
        """All metrics of a pair. raw_correct: correct matches of its raw frames."""
        matches = _match_pixels(matcher, first, second)
        motion = estimate_motion(*matches, matcher.matrix, self.params.inlier_px)
        error_deg = pose_error_deg(motion, pair.second_from_first)
        correct = int(self._correct(pair, *matches, matcher).sum())
        values = {"pose_error_deg": error_deg, "pose_inliers": motion.inliers if motion else 0}
        values |= {f"pose_auc_{limit}deg": curve_area(error_deg, limit) for limit in (5, 10, 20)}
        values |= {"correct_matches": correct}
        for name, value in values.items():
            yield Measurement(name, float(value), frame=pair.first)
        lost = 1.0 - correct / raw_correct if raw_correct else math.nan
        reason = None if raw_correct else "the raw frames have no correct match"
        yield Measurement("matches_lost", lost, frame=pair.first, reason=reason)


def _match_pixels(matcher: Matcher, first: KeypointSet, second: KeypointSet) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (M, 2) of the matches in the two images."""
    matches = matcher.match(first, second)
    return first.pixels[matches[:, 0]], second.pixels[matches[:, 1]]
