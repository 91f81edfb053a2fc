"""Map merging: one map of two that show one place.

Source: Elvira, Tardos, Montiel, "ORBSLAM-Atlas: a robust and accurate multi-map system", IROS 2019, arXiv:1908.11585.
The map that is tracked in stays where it is and the other one moves, so that nothing changes for the tracker.
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
class AbsorbedMap:
    """Where the content of another map is in this one."""

    numbers: Indices
    """Index here of each of its keyframes (K,); see Map.append."""
    first_point: int
    """Offset of the indices of its points; see Map.append."""
    map_from_other: Array
    """Similarity (4, 4) that moved it here."""
    loop: Loop
    """The loop between the two, which moves nothing."""


def absorb_map(mapper: Mapper, other: Mapper, loop: Loop) -> AbsorbedMap:
    """Move another map to where a keyframe of this one shows it, by `loop`, and add it to this one.

    Closing `AbsorbedMap.loop` then fuses duplicates and adjusts the map. Do not use `other` afterwards.
    """
    pose = mapper.map.keyframes.camera_from_world[loop.keyframe].copy()
    map_from_other = np.asarray(sim3_compose(se3_inverse(pose), loop.keyframe_from_world))
    other.map.transform(map_from_other)
    numbers, first_point = mapper.append(other, reroot_spanning_tree(other.map, loop.matched_keyframe))
    matched = int(numbers[loop.matched_keyframe])
    mapper.map.keyframes.parents[matched] = loop.keyframe
    points = np.where(loop.points >= 0, loop.points + first_point, NONE)
    return AbsorbedMap(numbers, first_point, map_from_other, Loop(loop.keyframe, matched, pose, points, loop.inliers))


def reroot_spanning_tree(slam_map: Map, root: int) -> Indices:
    """Make `root` the root of the spanning tree; returns all keyframes (K,), parents first.

    Keyframes are taken breadth first, the older of equals first, and culled ones last.
    """
    table = slam_map.keyframes
    linked: dict[int, list[int]] = {int(k): [] for k in slam_map.alive_keyframes}
    for k in linked:
        if table.parents[k] >= 0:
            linked[k].append(int(table.parents[k]))
            linked[int(table.parents[k])].append(k)
    order, waiting = dict.fromkeys([root]), deque([root])
    table.parents[root] = NONE
    while waiting:
        parent = waiting.popleft()
        for k in sorted(linked[parent]):
            if k not in order:
                table.parents[k] = parent
                order[k] = None
                waiting.append(k)
    order.update(dict.fromkeys(range(table.count)))
    return np.array(list(order), dtype=np.int64)
