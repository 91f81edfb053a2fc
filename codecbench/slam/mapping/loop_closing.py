"""Loop closing: fuse both sides of the loop, optimize the essential graph, adjust the whole map.

Source: ORB-SLAM VII-C, VII-D.
"""

from __future__ import annotations

import numpy as np

from codecbench.slam import thresholds
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.geometry.transforms import sim3_compose, sim3_from_parts, sim3_inverse, sim3_scale
from codecbench.slam.map.fusion import fuse
from codecbench.slam.map.map import Indices, Map
from codecbench.slam.mapping.loop_detection import Loop, rigid_part
from codecbench.slam.mapping.mapper import adjust_keyframes
from codecbench.slam.optimization import pose_graph


def close_loop(slam_map: Map, camera: Camera, loop: Loop) -> Array:
    """Correct the map for a loop; returns `before_from_after` (4, 4), a similarity.

    It takes the corrected surroundings of the loop's keyframe back to where they were.
    """
    table = slam_map.keyframes
    old = table.camera_from_world[: table.count].copy()
    edges = _essential_edges(slam_map)
    group = np.concatenate([[loop.keyframe], slam_map.neighbors(loop.keyframe)[0]])
    corrected = old.copy()
    for k in group:
        k_from_keyframe = old[k] @ np.linalg.inv(old[loop.keyframe])
        corrected[k] = sim3_compose(k_from_keyframe, loop.keyframe_from_world)
    pairs_before = _border_pairs(slam_map, group, 1)
    _fuse_loop_sides(slam_map, camera, loop, group, corrected)
    loop_edges = np.array(
        sorted(_border_pairs(slam_map, group, thresholds.COVISIBLE_MIN_POINTS) - pairs_before), dtype=np.int64
    ).reshape(-1, 2)
    slam_map.loop_edges.append((loop.matched_keyframe, loop.keyframe))
    new = _optimize_essential_graph(slam_map, old, corrected, edges, loop_edges, loop.matched_keyframe)
    _apply_corrections(slam_map, old, new)
    adjust_map(slam_map, camera)
    scale = sim3_scale(new[loop.keyframe])
    now = table.camera_from_world[loop.keyframe]
    keyframe_from_new = sim3_from_parts(scale, now[:3, :3].copy(), scale * now[:3, 3])
    return np.asarray(sim3_compose(np.linalg.inv(old[loop.keyframe]), keyframe_from_new))


def adjust_map(slam_map: Map, camera: Camera, iterations: tuple[int, ...] = (10, 10)) -> None:
    """Adjust all keyframes and points by bundle adjustment; the oldest keyframe stays."""
    keyframes = slam_map.alive_keyframes
    if len(keyframes) > 1:
        adjust_keyframes(
            slam_map, camera, keyframes[1:], keyframes[:1], slam_map.alive_points, iterations,
            huber=thresholds.MAP_HUBER_SIGMAS,
        )  # fmt: skip


def _fuse_loop_sides(slam_map: Map, camera: Camera, loop: Loop, group: Indices, corrected: Array) -> None:
    """Let the keyframes of this side see the loop side's points, instead of their duplicates."""
    side = np.concatenate([[loop.matched_keyframe], slam_map.neighbors(loop.matched_keyframe)[0]])
    points = slam_map.points_of(side)
    for feature in np.nonzero(loop.points >= 0)[0]:
        new = int(slam_map.resolve_points(loop.points[feature : feature + 1])[0])
        current = int(slam_map.keyframes.points[loop.keyframe, feature])
        if new < 0 or new == current:
            continue
        if current >= 0:
            slam_map.replace_points(np.array([current]), np.array([new]))
        elif not (slam_map.keyframes.points[loop.keyframe] == new).any():
            slam_map.observe(loop.keyframe, np.array([feature]), np.array([new]))
    for k in group:
        fuse(slam_map, camera, int(k), points, np.asarray(rigid_part(corrected[k])))
    slam_map.refresh_points(slam_map.points_of(group))


def _essential_edges(slam_map: Map) -> Indices:
    """Return the edges of the essential graph (E, 2), younger keyframe first.

    They are the spanning tree, the loops closed before, and pairs with many shared points.
    """
    edges = {(max(i, j), min(i, j)) for i, j in slam_map.loop_edges}
    for k in slam_map.alive_keyframes:
        if k > 0 and slam_map.keyframes.parents[k] >= 0:
            edges.add((int(k), int(slam_map.keyframes.parents[k])))
        neighbors, _ = slam_map.neighbors(int(k), min_points=thresholds.ESSENTIAL_MIN_WEIGHT)
        edges.update((int(k), int(j)) for j in neighbors if j < k)
    alive = slam_map.keyframes.alive
    return np.array(sorted(e for e in edges if alive[e[0]] and alive[e[1]]), dtype=np.int64).reshape(-1, 2)


def _border_pairs(slam_map: Map, group: Indices, min_points: int) -> set[tuple[int, int]]:
    """Return pairs (k, j) of a keyframe k of `group` and one j outside it that share at least `min_points` points.

    Pairs that appear when the two sides of a loop are fused measure the loop. Pairs that shared even one point before
    must not: only k of such a pair has been corrected, and as measurements they would keep the map torn at the border
    of the group.
    """
    inside = {int(k) for k in group}
    return {
        (k, int(j)) for k in inside for j in slam_map.neighbors(k, min_points=min_points)[0] if int(j) not in inside
    }


def _optimize_essential_graph(
    slam_map: Map, old: Array, corrected: Array, edges: Indices, loop_edges: Indices, fixed: int
) -> Array:
    """Return poses as similarities (K, 4, 4) that fit the essential graph; dead keyframes keep theirs."""
    alive = slam_map.alive_keyframes
    slots = np.full(slam_map.keyframes.count, -1, np.int64)
    slots[alive] = np.arange(len(alive))
    measurements = [old[j] @ np.linalg.inv(old[i]) for i, j in edges]
    measurements += [sim3_compose(corrected[j], sim3_inverse(corrected[i])) for i, j in loop_edges]
    solution = pose_graph.optimize(
        corrected[alive], slots[np.concatenate([edges, loop_edges])], np.array(measurements), alive == fixed
    )
    new = corrected.copy()
    new[alive] = solution.similarities
    return new


def _apply_corrections(slam_map: Map, old: Array, new: Array) -> None:
    """Move keyframes and points; a point moves with its reference keyframe."""
    table, points = slam_map.keyframes, slam_map.points
    alive = slam_map.alive_keyframes
    moved = slam_map.alive_points
    references = points.references[moved].copy()
    point_rows, seen_by, _ = slam_map.observations(moved)
    dead = ~table.alive[references]
    first_seen = np.zeros(len(moved), np.int64)
    first_seen[point_rows] = seen_by
    references[dead] = first_seen[dead]
    transforms = np.tile(np.eye(4), (table.count, 1, 1))
    for k in alive:
        transforms[k] = sim3_compose(sim3_inverse(new[k]), old[k])
        table.set_pose(int(k), np.asarray(rigid_part(new[k])))
        table.scales[k] /= sim3_scale(new[k])
    chosen = transforms[references]
    points.positions[moved] = np.einsum("nij,nj->ni", chosen[:, :3, :3], points.positions[moved]) + chosen[:, :3, 3]
    slam_map.refresh_points(moved, False)
