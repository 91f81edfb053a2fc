"""A walk round a cylinder of points whose scale has drifted, closed at its end."""

from __future__ import annotations

import numpy as np
import pytest
from map_scenes import build_map
from numpy.typing import NDArray
from rendered_scenes import CAMERA, looking, position_error, random_descriptors

from codecbench.slam.geometry.transforms import sim3_from_parts
from codecbench.slam.map.map import Map
from codecbench.slam.mapping import loop_closing
from codecbench.slam.mapping.loop_closing import close_loop
from codecbench.slam.mapping.loop_detection import Loop

pytestmark = pytest.mark.thorough

STEPS = 48
LAST = STEPS - 1
Floats = NDArray[np.float64]


def circle_pose(step: int) -> Floats:
    """Looking outwards from a circle of radius 2; the last steps see what the first ones saw."""
    turn = 2.0 * np.pi * step / (STEPS - 5)
    return looking((2.0 * np.sin(turn), 0.0, 2.0 * np.cos(turn)), turn)


def drifting_map(drift: float) -> tuple[Map, Loop, Floats]:
    """The map as an odometry leaves it, the true loop, and the true camera centres.

    Every step is `drift` times as long as the one before makes it, its points as far; what the first keyframes saw is
    not recognised in the second half.
    """
    rng = np.random.default_rng(8)
    count = 1500
    angles, radii = rng.uniform(0.0, 2.0 * np.pi, count), rng.uniform(5.0, 8.0, count)
    points = np.column_stack([radii * np.sin(angles), rng.uniform(-2.0, 2.0, count), radii * np.cos(angles)])
    true = [circle_pose(i) for i in range(STEPS)]
    descriptors = random_descriptors(rng, count)
    again = np.concatenate([points, points])  # each point twice: as seen early, and as seen late
    slam_map, _ = build_map(true, again, np.concatenate([descriptors, descriptors]))
    table = slam_map.keyframes.points
    shared = np.zeros(2 * count, np.bool_)
    shared[np.unique(table[:12][table[:12] >= 0]) % count] = True
    for k in range(STEPS):
        late = (k >= STEPS // 2) & shared[table[k] % count]
        wrong = np.nonzero((table[k] >= 0) & ((table[k] >= count) != late))[0]
        slam_map.unobserve(np.full(len(wrong), k), wrong)
    seen_points = np.unique(table[:STEPS][table[:STEPS] >= 0])
    slam_map.remove_points(np.setdiff1d(slam_map.alive_points, seen_points))
    slam_map.refresh_points(slam_map.alive_points)
    scales = drift ** np.arange(STEPS)
    drifted = [true[0]]
    for k in range(1, STEPS):
        step = true[k] @ np.linalg.inv(true[k - 1])
        step[:3, 3] *= scales[k]
        drifted.append(step @ drifted[-1])
    for point in slam_map.alive_points:
        k = int(np.nonzero((slam_map.keyframes.points[:STEPS] == point).any(axis=1))[0][0])
        slam_map.points.references[point] = k
        in_camera = true[k][:3] @ np.append(slam_map.points.positions[point], 1.0)
        slam_map.points.positions[point] = np.linalg.inv(drifted[k])[:3] @ np.append(in_camera * scales[k], 1.0)
    slam_map.keyframes.set_pose(np.arange(STEPS), np.array(drifted))
    slam_map.refresh_points(slam_map.alive_points, False)
    seen_last = slam_map.keyframes.points[LAST]
    early = np.where(seen_last >= count, seen_last - count, -1)
    early[(early >= 0) & ~np.isin(early, slam_map.keyframes.points[0])] = -1
    loop_pose = sim3_from_parts(scales[LAST], true[LAST][:3, :3].copy(), scales[LAST] * true[LAST][:3, 3])
    loop = Loop(LAST, 0, loop_pose, early, int((early >= 0).sum()))
    return slam_map, loop, np.array([np.linalg.inv(pose)[:3, 3] for pose in true])


def centres(slam_map: Map) -> Floats:
    return np.asarray(slam_map.keyframes.centers_world[:STEPS])


@pytest.mark.parametrize("drift", [1.0, 1.01, 0.985])
def test_a_loop_takes_the_drift_out_of_the_whole_walk(drift: float) -> None:
    slam_map, loop, true = drifting_map(drift)
    before = position_error(centres(slam_map), true)
    close_loop(slam_map, CAMERA, loop)
    after = position_error(centres(slam_map), true)
    assert after < 1e-6
    assert before > 0.2 or drift == 1.0


def test_the_graph_alone_spreads_the_drift_and_tears_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop_closing, "adjust_map", lambda *_: None)
    slam_map, loop, true = drifting_map(1.01)
    before = position_error(centres(slam_map), true)
    close_loop(slam_map, CAMERA, loop)
    steps = np.linalg.norm(np.diff(centres(slam_map), axis=0), axis=1)
    assert position_error(centres(slam_map), true) < 0.5 * before
    assert steps.max() / steps.min() < 1.5
