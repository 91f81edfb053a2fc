"""Making one map of two that show one place.

Source: Elvira, Tardos, Montiel, "ORBSLAM-Atlas: a robust and accurate multi-map system", IROS 2019, arXiv:1908.11585.
The map that is tracked in stays where it is and the other one moves, so that nothing changes that tracking holds on to.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from codecbench.slam.geometry.rotations import Array
from codecbench.slam.geometry.transforms import se3_inverse, sim3_compose
from codecbench.slam.map.map import NONE, Indices, Map
from codecbench.slam.mapping.loop_detection import Loop
from codecbench.slam.mapping.mapper import Mapper


@dataclass(frozen=True)
class Joint:
    """Where the content of another map is now: `numbers` (K,) and `first_point` as Map.append returns them,
    `map_from_other` (4, 4) the similarity that brought it here, and the `loop` between the two, which moves nothing."""

    numbers: Indices
    first_point: int
    map_from_other: Array
    loop: Loop


def take_in(mapper: Mapper, other: Mapper, seen: Loop) -> Joint:
    """Move another map to where a keyframe of this one has seen it, and add it to this one.

    Duplicates are not merged yet, nor is anything adjusted: closing `Joint.loop` does both. `other` is of no use
    afterwards.
    """
    pose = mapper.map.keyframes.camera_from_world[seen.keyframe].copy()
    map_from_other = np.asarray(sim3_compose(se3_inverse(pose), seen.keyframe_from_world))
    other.map.transform(map_from_other)
    numbers, first_point = mapper.append(other, reroot_spanning_tree(other.map, seen.matched))
    matched = int(numbers[seen.matched])
    mapper.map.keyframes.parents[matched] = seen.keyframe
    points = np.where(seen.points >= 0, seen.points + first_point, NONE)
    return Joint(numbers, first_point, map_from_other, Loop(seen.keyframe, matched, pose, points, seen.inliers))


def reroot_spanning_tree(slam_map: Map, root: int) -> Indices:
    """Make `root` the root of the spanning tree; returns all keyframes (K,) in an order in which parents come first.

    Keyframes are taken breadth first, the older of equals first, and those that have been culled last.
    """
    table = slam_map.keyframes
    joined: dict[int, list[int]] = {int(k): [] for k in slam_map.alive_keyframes}
    for k in joined:
        if table.parents[k] >= 0:
            joined[k].append(int(table.parents[k]))
            joined[int(table.parents[k])].append(k)
    order, waiting = dict.fromkeys([root]), deque([root])
    table.parents[root] = NONE
    while waiting:
        parent = waiting.popleft()
        for k in sorted(joined[parent]):
            if k not in order:
                table.parents[k] = parent
                order[k] = None
                waiting.append(k)
    order.update(dict.fromkeys(range(table.count)))
    return np.array(list(order), dtype=np.int64)
