from __future__ import annotations

import numpy as np
import pytest
from map_scenes import build_map, observe_scene
from numpy.typing import NDArray
from rendered_scenes import CAMERA, looking, random_descriptors

from codecbench.slam import atlas
from codecbench.slam.atlas import TrackedMap
from codecbench.slam.geometry.transforms import se3_inverse
from codecbench.slam.map.map import Map
from codecbench.slam.mapping.loop_detection import Loop
from codecbench.slam.tracking.tracked_pose import transform_camera


def test_the_last_frame_follows_its_reference_when_a_loop_is_closed(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A loop may be closed after the keyframe's frame: what is tracked next starts from where the map is by then."""
    points, descriptors = rng.uniform([-1.0, -1.5, 4.0], [2.0, 1.5, 7.0], (60, 3)), random_descriptors(rng, 60)
    slam_map, mapper = build_map([looking((0.2 * i, 0.0, 0.0)) for i in range(3)], points, descriptors)
    followed = TrackedMap(slam_map, mapper, CAMERA, rng)
    frame, frame.points = observe_scene(looking((0.5, 0.1, 0.0), yaw=0.05), points, descriptors)
    frame.reference = 2
    followed._tracker.start(frame)
    before = se3_inverse(frame.camera_from_world)
    turned = 1.2 * looking((0.0, 0.0, 0.0), yaw=0.3)
    turned[:, 3] = 0.4, -0.2, 0.1, 1.0

    def close(slam_map: Map, *_: object) -> NDArray[np.float64]:
        slam_map.transform(turned)
        return np.asarray(np.linalg.inv(turned))

    monkeypatch.setattr(atlas, "close_loop", close)
    monkeypatch.setattr(followed._detector, "detect", lambda k: Loop(k, 0, np.eye(4), np.empty(0, np.int64), 50))
    closed = followed.close_loop(2)
    assert closed is not None
    assert (closed.frame_index, closed.matched_frame_index) == (2, 0)
    assert np.allclose(se3_inverse(frame.camera_from_world), transform_camera(turned, before), atol=1e-12)
    followed.record(frame)
    assert np.allclose(followed.finish(adjust=False).trajectory_before_loops.world_from_camera, before, atol=1e-12)
