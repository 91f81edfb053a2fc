"""The `localization` evaluator locates decoded frames in a map of the raw ones."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Final

import numpy as np
from pydantic import Field

from codecbench.core.contracts.codec import Architecture, gets_features
from codecbench.core.contracts.evaluator import (
    CodedSequence,
    Context,
    Measurement,
    PluginUse,
    SequenceEvaluator,
)
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.contracts.sequence import Frame
from codecbench.core.simulation.delivery import DeliveredFrames, delivery_of
from codecbench.core.simulation.settings import ReaderSettings, Time
from codecbench.plugins.evaluators.reference_map import (
    LocalizedPose,
    ReferenceMap,
    Way,
    build_reference_map,
)
from codecbench.plugins.evaluators.trajectory.alignment import rotation_angles_deg
from codecbench.slam.features.extractor import Features

WAYS: Final = {"tracked": "from the previous pose", "relocalized": "by relocalization"}
"""How a frame is located, by the prefix of the metrics."""


def _metrics_of(way: str, how: str) -> tuple[Metric, ...]:
    def task(name: str, unit: str, summary: str, label: str) -> Metric:
        spread, summary, label = ("median", "p95"), f"{summary}, {how}", f"{label}, {how}"
        return Metric(f"{way}_{name}", unit, "lower", summary, spread, role="task", label=label, scale="log")

    return (
        Metric(
            f"{way}_located", "1", "higher", f"1 if located {how}, else 0",
            role="task", label=f"located {how}",
        ),
        Metric(
            f"{way}_inliers", "1", "higher", f"map points that support a correct pose, else 0, {how}",
            role="task", headline=way == "tracked", label=f"map points found, {how}", column_header="map points",
        ),
        task("position_error_mm", "mm", "distance from the true position", "position error"),
        task("rotation_error_deg", "deg", "angle from the true orientation", "rotation error"),
        task("position_to_raw_mm", "mm", "distance from the raw frame's position", "position offset from raw"),
        task("rotation_to_raw_deg", "deg", "angle from the raw frame's orientation", "rotation offset from raw"),
    )  # fmt: skip


METRICS: Final = (
    Metric(
        "located_auc", "1", "higher",
        "max(0, 1 - d / L), d the distance from the raw frame's position",
        role="task", headline=True, label="localisation AUC", column_header="located", enough=0.9,
    ),
    *(metric for way, how in WAYS.items() for metric in _metrics_of(way, how)),
)  # fmt: skip
_BACKEND = "orb"


class LocalizationParams(ReaderSettings):
    """Set the map, the limits of a correct pose, and optionally a link.

    backend_params: parameters of the SLAM backend `orb`, which makes the map and detects features.
    architecture: `features` refuses image codecs; otherwise a frame is located by what its codec sends.
    limit_share: distance from the raw frame's position at which a pose scores 0, as a share of the scene's median
    depth; also the angle from its orientation, in radians, beyond which map points do not count.
    association_s: largest time between a frame and its ground truth, in seconds.
    The others are about a link, see ReaderSettings. A frame that is not delivered is not located, nor is one that
    arrives during the slam_ms in which another is located.
    """

    backend_params: dict[str, Any] = Field(default_factory=dict)
    architecture: Architecture = "cta"
    limit_share: Annotated[float, Field(gt=0.0, le=1.0)] = 0.01
    association_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    slam_ms: Time = 0.0
    """A number, never `measured`: the SLAM that `trajectory` times does more than locating."""


class Localization(SequenceEvaluator[LocalizationParams]):
    """Locates each frame by itself, so that its result depends on no other frame.

    The map is built once from raw frames and cached with them, under all that it depends on. Nothing is random, so
    equal frames give equal values whatever the codec.
    """

    name = "localization"
    version = "6"
    params_type = LocalizationParams
    needs = frozenset({"camera", "ground_truth"})
    kernels = ("codecbench.slam",)
    typical_ms_per_frame = 25.0
    metrics: ClassVar[tuple[Metric, ...]] = METRICS

    @property
    def uses(self) -> tuple[PluginUse, ...]:
        return (PluginUse("slam_backend", _BACKEND, self.params.backend_params), *self.params.link_uses)

    @property
    def requires(self) -> dict[str, Quantity]:
        return self.params.requires

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        sends_features = gets_features(coded.codec, self.params.architecture)
        sequence = coded.sequence
        backend = context.plugins.create("slam_backend", _BACKEND, self.params.backend_params)
        key = (
            "localization",
            self.version,
            backend.version,
            backend.params.model_dump_json(),
            self.params.model_dump_json(exclude={*ReaderSettings.model_fields, "architecture"}),
        )
        reference_map = sequence.read(0).cached(
            (*key, "survey"),
            lambda _: build_reference_map(sequence, backend, self.params.association_s, self.params.limit_share),
        )
        for index, reason in reference_map.reasons.items():
            yield from (Measurement(metric.name, math.nan, frame=index, reason=reason) for metric in METRICS)
        delivery = None if self.params.link is None else delivery_of(coded, self.params, context)
        pictures = None if delivery is None else DeliveredFrames(coded, delivery)
        read_at = {} if delivery is None else delivery.read_at(self.params.read_s)

        def receive(index: int) -> Features | None:
            if sends_features:
                return reference_map.localizer.features_of(backend.keypoints(coded.features(index)))
            decoded = coded.frame(index).decoded if pictures is None else pictures.image(index)
            return None if decoded is None else reference_map.localizer.extract(np.asarray(decoded, np.uint8))

        for index in reference_map.predictions:
            features = None if delivery is not None and index not in read_at else receive(index)
            raw = _raw_poses(reference_map, sequence.read(index), key)
            poses = _UNDELIVERED if features is None else reference_map.localize(features, index)
            yield from _frame_measurements(reference_map, index, poses, raw)


_UNDELIVERED: Final[dict[Way, LocalizedPose | None]] = {"tracked": None, "relocalized": None}
"""The poses of a frame that is not delivered in time."""


def _raw_poses(reference_map: ReferenceMap, frame: Frame, key: tuple[object, ...]) -> dict[Way, LocalizedPose | None]:
    return frame.cached(
        (*key, "raw"),
        lambda image: reference_map.localize(reference_map.localizer.extract(np.asarray(image, np.uint8)), frame.index),
    )


def _frame_measurements(
    reference_map: ReferenceMap,
    index: int,
    poses: dict[Way, LocalizedPose | None],
    raw: dict[Way, LocalizedPose | None],
) -> Iterator[Measurement]:
    """All metrics of one frame."""
    for way, localized in poses.items():
        yield Measurement(f"{way}_located", float(localized is not None), frame=index)
        yield _inliers(reference_map, f"{way}_inliers", index, localized, raw["tracked"])
        true = reference_map.truth[index]
        yield from _distance(way, "error", localized, true, index, "the frame has no true pose")
        raw_pose = raw[way]
        expected = np.full((4, 4), np.nan) if raw_pose is None else raw_pose.world_from_camera
        yield from _distance(way, "to_raw", localized, expected, index, "the raw frame is not located")
    yield _area(reference_map, index, poses["tracked"], raw["tracked"])


def _distance(
    way: Way, what: str, localized: LocalizedPose | None, reference: np.ndarray, index: int, unknown: str
) -> Iterator[Measurement]:
    """Distance in mm and angle in degrees from a reference pose; missing if either pose is missing."""
    names = (f"{way}_position_{what}_mm", f"{way}_rotation_{what}_deg")
    reason = "the frame is not located" if localized is None else unknown if np.isnan(reference).any() else None
    if localized is None or reason:
        yield from (Measurement(name, math.nan, frame=index, reason=reason) for name in names)
        return
    pose = localized.world_from_camera
    values = (
        1e3 * float(np.linalg.norm(pose[:3, 3] - reference[:3, 3])),
        float(rotation_angles_deg(pose[:3, :3].T @ reference[:3, :3])),
    )
    yield from (Measurement(name, value, frame=index) for name, value in zip(names, values, strict=True))


def _inliers(
    reference_map: ReferenceMap, metric: str, index: int, localized: LocalizedPose | None, raw: LocalizedPose | None
) -> Measurement:
    """The map points behind a pose if it is right, else 0: within both limits of the raw frame's pose."""
    if raw is None:
        return Measurement(metric, math.nan, frame=index, reason="the raw frame is not located")
    if localized is None:
        return Measurement(metric, 0.0, frame=index)
    pose, expected = localized.world_from_camera, raw.world_from_camera
    near = np.linalg.norm(pose[:3, 3] - expected[:3, 3]) < reference_map.limit_m
    right = near and rotation_angles_deg(pose[:3, :3].T @ expected[:3, :3]) < reference_map.limit_deg
    return Measurement(metric, float(localized.inliers if right else 0), frame=index)


def _area(
    reference_map: ReferenceMap, index: int, localized: LocalizedPose | None, raw: LocalizedPose | None
) -> Measurement:
    """The frame's share, 0 to 1, of the area under the curve of located frames over distance."""
    if raw is None:
        return Measurement("located_auc", math.nan, frame=index, reason="the raw frame is not located")
    if localized is None:
        return Measurement("located_auc", 0.0, frame=index)
    distance_m = np.linalg.norm(localized.world_from_camera[:3, 3] - raw.world_from_camera[:3, 3])
    return Measurement("located_auc", max(0.0, 1.0 - float(distance_m) / reference_map.limit_m), frame=index)
