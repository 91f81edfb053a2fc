"""Maps with known answers: keyframes on a path before a cloud of points, every observation exact."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from rendered_scenes import CAMERA, features_at

from codecbench.slam.features.extractor import pixel_variances
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import NONE, Map
from codecbench.slam.mapping.mapper import Mapper

FACTORS = 1.2 ** np.arange(8)
VARIANCES = pixel_variances(CAMERA, FACTORS)


def observe_scene(
    pose: NDArray[np.float64], points: NDArray[np.float64], descriptors: NDArray[np.uint64], camera: Camera = CAMERA
) -> tuple[TrackingFrame, NDArray[np.int64]]:
    """A frame that sees every point in front of it exactly, and which point each feature shows."""
    in_camera = points @ pose[:3, :3].T + pose[:3, 3]
    ahead = np.nonzero(in_camera[:, 2] > 0.2)[0]
    pixels = camera.project(in_camera[ahead])
    inside = (pixels > 5.0).all(axis=1) & (pixels < [camera.width - 6.0, camera.height - 6.0]).all(axis=1)
    shown, pixels = ahead[inside], pixels[inside]
    frame = TrackingFrame.of(0, 0.0, features_at(pixels, descriptors[shown]))
    frame.camera_from_world = pose.copy()
    return frame, shown


def build_map(
    poses: list[NDArray[np.float64]], points: NDArray[np.float64], descriptors: NDArray[np.uint64]
) -> tuple[Map, Mapper]:
    """A map with a keyframe at each pose and each point, map index i being point i."""
    slam_map = Map(0, FACTORS, VARIANCES, len(points))
    mapper = Mapper(slam_map, CAMERA)
    slam_map.points.add(points, 0, 0)
    for index, pose in enumerate(poses):
        frame, shown = observe_scene(pose, points, descriptors)
        frame.index, frame.timestamp_s = index, float(index)
        keyframe = mapper.add(frame)
        slam_map.observe(keyframe, np.arange(len(shown)), shown)
        slam_map.points.references[shown[slam_map.points.observation_counts[shown] == 1]] = keyframe
        slam_map.attach(keyframe)
    slam_map.refresh_points(np.nonzero(slam_map.points.observation_counts[: len(points)] > 0)[0])
    return slam_map, mapper


def assert_consistent(slam_map: Map) -> None:
    """What keyframes say about points and what points say about keyframes is the same."""
    alive = slam_map.alive_points
    which, keyframes, features = slam_map.observations(alive)
    assert (slam_map.keyframes.points[keyframes, features] == alive[which]).all()
    seen = slam_map.keyframes.points[: slam_map.keyframes.count]
    assert (seen != NONE).sum() == len(which)
    assert slam_map.points.alive[seen[seen >= 0]].all()
    assert np.array_equal(np.bincount(which, minlength=len(alive)), slam_map.points.observation_counts[alive])
