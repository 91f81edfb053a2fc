"""The map: keyframes, map points and the covisibility graph (ORB-SLAM III-C, III-D)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from codecbench.slam.geometry.rotations import Array
from codecbench.slam.geometry.transforms import sim3_scale
from codecbench.slam.map import observation_kernels, point_kernels
from codecbench.slam.map.tables import NONE, Indices, KeyframeTable, PointTable, ensure_rows
from codecbench.slam.thresholds import COVISIBLE_MIN_POINTS, POINT_VARIANCES

__all__ = ["NONE", "CulledKeyframe", "Indices", "KeyframeTable", "Map", "PointTable", "ensure_rows"]


@dataclass(frozen=True)
class CulledKeyframe:
    """How a removed keyframe stays attached to the map."""

    anchor: int
    """The keyframe to which it is attached."""
    camera_from_anchor: Array
    """Relative pose (4, 4)."""
    anchor_scale: float
    """Scale of the anchor when the keyframe was removed."""


class Map:
    """Keyframes and map points with the graph between them.

    `scale_factors` (L,) are those of the pyramid levels; `pixel_variances` (L,) those of a keypoint there along each
    axis, px^2.
    """

    def __init__(self, index: int, scale_factors: Array, pixel_variances: Array, features_limit: int) -> None:
        self.index = index
        self.scale_factors = scale_factors
        self.pixel_variances = pixel_variances
        self.inverse_sigma2: Array = 1.0 / pixel_variances
        self.inverse_sigma2_of_points: Array = 1.0 / (POINT_VARIANCES * pixel_variances)
        self.points = PointTable()
        self.keyframes = KeyframeTable(features_limit)
        self.culled: dict[int, CulledKeyframe] = {}
        self.loop_edges: list[tuple[int, int]] = []
        self._covisible: dict[int, tuple[Indices, Indices]] = {}  # cache, valid until observations change
        self._link_count = 0
        self._links = np.empty((16384, 3), np.int32)

    # Observations ---------------------------------------------------------------------------------------------

    def observe(self, keyframes: int | Indices, features: Indices, points: Indices) -> None:
        """Record that a keyframe, or keyframes[i], sees points[i] at features[i].

        Neither the point nor the feature may have an observation there yet.
        """
        self._covisible.clear()
        keyframes = np.full(len(points), keyframes, np.int64)
        first = self._link_count
        self._link_count += len(points)
        self._links = ensure_rows(self._links, self._link_count, NONE)
        observation_kernels.add_links(
            points, keyframes, features, first, self.points.heads, self.points.observation_counts, self._links
        )
        self.keyframes.points[keyframes, features] = points

    @property
    def _observation_links(self) -> observation_kernels.Links:
        table = self.points
        return observation_kernels.Links(
            table.heads, table.observation_counts, self._links, self.keyframes.points, table.alive
        )

    def unobserve(self, keyframes: Indices, features: Indices) -> None:
        """Remove what keyframes[i] sees at features[i]; a point that fewer than two keyframes see dies."""
        self._covisible.clear()
        observation_kernels.remove_observations(keyframes, features, self._observation_links)

    def observations(self, points: Indices, among: Indices | None = None) -> tuple[Indices, Indices, Indices]:
        """Return index into `points`, keyframe and feature, (M,) each, of observations by keyframes `among`, or all."""
        included = np.full(self.keyframes.count, among is None)
        included[among if among is not None else []] = True
        point_rows, keyframes, features = observation_kernels.list_observations(
            points, included, self.points.observation_counts, self.points.heads, self._links
        )
        return point_rows, keyframes, features

    def remove_points(self, points: Indices) -> None:
        """Remove points and their observations."""
        self._covisible.clear()
        observation_kernels.remove_points(points, self._observation_links)

    def replace_points(self, old: Indices, new: Indices) -> None:
        """Let new[i] be seen wherever old[i] was, unless it is seen there already; old[i] dies.

        No point may be in both.
        """
        self._covisible.clear()
        table = self.points
        replacements = observation_kernels.Replacements(table.replaced_by, table.found_counts, table.visible_counts)
        observation_kernels.replace_points(old, new, self._observation_links, replacements)

    def resolve_points(self, points: Indices) -> Indices:
        """Return `points` (N,) with replaced ones exchanged for their replacements and dead ones for NONE."""
        return np.asarray(observation_kernels.resolve_points(points, self.points.replaced_by, self.points.alive))

    def refresh_points(self, points: Indices, descriptors: bool = True) -> None:
        """Recompute what points derive from their observations: normal, distances, descriptor."""
        table, keyframes = self.points, self.keyframes
        point_kernels.refresh_points(
            points, table.positions, table.references, table.heads, self._links,
            keyframes.centers_world, keyframes.octaves, keyframes.descriptors, self.scale_factors,
            table.normals, table.min_distances, table.max_distances, table.descriptors, descriptors,
        )  # fmt: skip

    # The graph ------------------------------------------------------------------------------------------------

    def covisibility(self, points: Indices) -> Indices:
        """Return how many of `points` each keyframe sees (K,); NONE is skipped."""
        return np.asarray(
            observation_kernels.count_covisible(points, self.keyframes.count, self.points.heads, self._links)
        )

    def neighbors(
        self, keyframe: int, limit: int | None = None, min_points: int = COVISIBLE_MIN_POINTS
    ) -> tuple[Indices, Indices]:
        """Return the keyframes that share `min_points` points with `keyframe`, most first, and how many they share."""
        if keyframe not in self._covisible:
            self._covisible[keyframe] = self._find_covisible(keyframe)
        keyframes, weights = self._covisible[keyframe]
        end = np.count_nonzero(weights >= min_points)
        return keyframes[:end][:limit], weights[:end][:limit]

    def _find_covisible(self, keyframe: int) -> tuple[Indices, Indices]:
        order, weights = self.rank_covisible(self.keyframes.points[keyframe], keyframe)
        order.flags.writeable = weights.flags.writeable = False  # the cache shares them
        return order, weights

    def rank_covisible(self, points: Indices, excluded: int = NONE) -> tuple[Indices, Indices]:
        """Return keyframes but `excluded` that see any of `points`, most first, and how many they see.

        NONE is skipped.
        """
        keyframes, counts = observation_kernels.rank_covisible(
            points, excluded, self.keyframes.count, self.points.heads, self._links
        )
        return keyframes, counts

    def points_of(self, keyframes: Indices) -> Indices:
        """Return the points that any of `keyframes` sees, ascending."""
        return np.asarray(observation_kernels.union_of_points(keyframes, self.keyframes.points, self.points.count))

    def is_redundant(self, keyframe: int) -> bool:
        """Return whether enough others see nearly all points of `keyframe` at least as finely (ORB-SLAM VI-E)."""
        return bool(
            point_kernels.is_redundant(
                self.keyframes.points[keyframe], keyframe, self.keyframes.octaves, self.points.heads, self._links
            )
        )  # fmt: skip

    # Keyframes ------------------------------------------------------------------------------------------------

    def attach(self, keyframe: int) -> None:
        """Attach `keyframe` to the spanning tree, below the older keyframe with which it shares most points."""
        weights = self.covisibility(self.keyframes.points[keyframe])[:keyframe]
        if len(weights) and weights.max() > 0:
            self.keyframes.parents[keyframe] = int(np.argmax(weights))
        elif keyframe > 0:
            self.keyframes.parents[keyframe] = int(np.nonzero(self.keyframes.alive[:keyframe])[0][-1])

    def remove_keyframe(self, keyframe: int) -> None:
        """Remove a keyframe: its frames follow its parent, and its children are attached anew."""
        table = self.keyframes
        parent = int(table.parents[keyframe])
        camera_from_anchor = table.camera_from_world[keyframe] @ np.linalg.inv(table.camera_from_world[parent])
        self.culled[keyframe] = CulledKeyframe(parent, camera_from_anchor, float(table.scales[parent]))
        seen = np.nonzero(table.points[keyframe] >= 0)[0]
        self.unobserve(np.full(len(seen), keyframe), seen)
        table.alive[keyframe] = False
        for child in np.nonzero((table.parents[: table.count] == keyframe) & table.alive[: table.count])[0]:
            self.attach(int(child))

    def pose(self, keyframe: int) -> Array:
        """Return camera_from_world (4, 4) of a keyframe, alive or culled."""
        pose = np.eye(4)
        while keyframe in self.culled:
            link = self.culled[keyframe]
            step = link.camera_from_anchor.copy()
            step[:3, 3] *= self.scale_of(link.anchor) / link.anchor_scale
            pose, keyframe = pose @ step, link.anchor
        return np.asarray(pose @ self.keyframes.camera_from_world[keyframe])

    def scale_of(self, keyframe: int) -> float:
        """Return how much loop corrections have stretched the surroundings of a keyframe, alive or culled."""
        scale = 1.0
        while keyframe in self.culled:
            link = self.culled[keyframe]
            scale *= float(self.keyframes.scales[keyframe]) / link.anchor_scale
            keyframe = link.anchor
        return scale * float(self.keyframes.scales[keyframe])

    def rescale(self, factor: float) -> None:
        """Multiply all lengths by `factor`."""
        self.transform(np.diag([factor, factor, factor, 1.0]))

    def transform(self, new_from_old: Array) -> None:
        """Move all keyframes and points by a similarity (4, 4)."""
        scale = sim3_scale(new_from_old)
        rotation, translation = new_from_old[:3, :3] / scale, new_from_old[:3, 3]
        table, positions = self.keyframes, self.points.positions[: self.points.count]
        poses = table.camera_from_world[: table.count].copy()
        poses[:, :3, :3] = poses[:, :3, :3] @ rotation.T
        poses[:, :3, 3] = scale * poses[:, :3, 3] - poses[:, :3, :3] @ translation
        table.set_pose(np.arange(table.count), poses)
        table.scales[self.alive_keyframes] *= scale  # culled ones hang on these
        positions[:] = scale * (positions @ rotation.T) + translation
        self.refresh_points(self.alive_points, False)

    def append(self, other: Map, order: Indices) -> tuple[Indices, int]:
        """Add the content of another map, which must be in this map's coordinates.

        `order` (K,) lists all its keyframes as they are to be added. Returns the index here of each of them (K,), and
        what has been added to the indices of its points.
        """
        self._covisible.clear()
        first_keyframe, first_point, first_link = self.keyframes.count, self.points.count, self._link_count
        numbers = np.empty(len(order), np.int64)
        numbers[order] = first_keyframe + np.arange(len(order))
        points, keyframes = self.points, self.keyframes
        points.append(other.points)
        keyframes.append(other.keyframes, order)
        new_points, new_keyframes = slice(first_point, points.count), slice(first_keyframe, keyframes.count)
        points.born[new_points] += first_keyframe
        points.references[new_points] = _renumber(points.references[new_points], numbers)
        points.replaced_by[new_points] = _shift_indices(points.replaced_by[new_points], first_point)
        points.heads[new_points] = _shift_indices(points.heads[new_points], first_link)
        keyframes.points[new_keyframes] = _shift_indices(keyframes.points[new_keyframes], first_point)
        keyframes.parents[new_keyframes] = _renumber(keyframes.parents[new_keyframes], numbers)
        self._append_links(other, numbers)
        for k, link in other.culled.items():
            self.culled[int(numbers[k])] = replace(link, anchor=int(numbers[link.anchor]))
        self.loop_edges += [(int(numbers[i]), int(numbers[j])) for i, j in other.loop_edges]
        return numbers, first_point

    def _append_links(self, other: Map, numbers: Indices) -> None:
        links = other._links[: other._link_count].astype(np.int64)
        first = self._link_count
        self._link_count += len(links)
        self._links = ensure_rows(self._links, self._link_count, NONE)
        following, keyframes = _shift_indices(links[:, 0], first), _renumber(links[:, 1], numbers)
        self._links[first : self._link_count] = np.column_stack([following, keyframes, links[:, 2]])

    @property
    def alive_keyframes(self) -> Indices:
        return np.nonzero(self.keyframes.alive[: self.keyframes.count])[0]

    @property
    def alive_points(self) -> Indices:
        return np.nonzero(self.points.alive[: self.points.count])[0]


def _shift_indices(indices: Indices, offset: int) -> Indices:
    """Return `indices` with `offset` added; NONE stays."""
    return np.where(indices >= 0, indices + offset, NONE)


def _renumber(indices: Indices, numbers: Indices) -> Indices:
    """Return `numbers` at `indices`; NONE stays."""
    return np.append(numbers, NONE)[indices]  # NONE is -1: the last
