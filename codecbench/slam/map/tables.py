"""The tables of the map: points and keyframes, one a row, in arrays that grow."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from codecbench.slam.features.extractor import Features
from codecbench.slam.geometry.rotations import Array

Indices = NDArray[np.int64]
NONE = -1
"""The index that stands for no point or no keyframe."""


def ensure_rows(array: NDArray[Any], rows: int, fill: Any) -> NDArray[Any]:
    """Return `array` with at least `rows` rows; if it must grow, it doubles, and new rows hold `fill`."""
    if rows <= len(array):
        return array
    shape = max(2 * len(array), rows), *array.shape[1:]
    # Zeros cost nothing until their memory is used; filling 15 MB takes longer than tracking a frame.
    longer = np.full(shape, fill, array.dtype) if fill else np.zeros(shape, array.dtype)
    longer[: len(array)] = array
    return longer


class PointTable:
    """The points, one a row; the first `count` rows are in use, dead ones (see `alive`) among them.

    `positions`, `normals` (mean viewing direction) (P, 3) in the world; `min_distances`, `max_distances` at which the
    pyramid can show the point; `descriptors` (P, 4); `visible_counts`, `found_counts`: in how many frames a point
    should be seen, and is; `born`: number of keyframes made before it; `references`: keyframe whose view gave its
    scale; `replaced_by`: the point that took its place, or NONE.
    """

    def __init__(self, capacity: int = 4096) -> None:
        self.count = 0
        self.positions = np.zeros((capacity, 3))
        self.normals = np.zeros((capacity, 3))
        self.min_distances = np.zeros(capacity)
        self.max_distances = np.zeros(capacity)
        self.descriptors = np.zeros((capacity, 4), np.uint64)
        self.alive = np.zeros(capacity, np.bool_)
        self.visible_counts = np.zeros(capacity, np.int64)
        self.found_counts = np.zeros(capacity, np.int64)
        self.born = np.zeros(capacity, np.int64)
        self.references = np.full(capacity, NONE, np.int64)
        self.replaced_by = np.full(capacity, NONE, np.int64)
        self.heads = np.full(capacity, NONE, np.int64)
        self.observation_counts = np.zeros(capacity, np.int64)

    def add(self, positions: Array, reference: int, born: int) -> Indices:
        """Add points at `positions` (N, 3); returns their indices (N,)."""
        added = np.arange(self.count, self.count + len(positions))
        _add_rows(self, len(positions))
        self.positions[added] = positions
        self.alive[added] = True
        self.visible_counts[added] = self.found_counts[added] = 1
        self.born[added], self.references[added] = born, reference
        return added

    def append(self, other: PointTable) -> None:
        """Add all rows of another table unchanged; the caller renumbers what they say of other rows."""
        _append_table(self, other, np.arange(other.count))


_FILLS = {"references": NONE, "replaced_by": NONE, "heads": NONE, "points": NONE, "frame_indices": NONE,
          "parents": NONE, "scales": 1.0}  # fmt: skip
"""What columns hold in rows that are not in use yet, if it is not 0."""


def _add_rows(table: PointTable | KeyframeTable, rows: int) -> None:
    """Take `rows` more rows into use."""
    table.count += rows
    for name, array in vars(table).items():
        if isinstance(array, np.ndarray):
            setattr(table, name, ensure_rows(array, table.count, _FILLS.get(name, 0)))


def _append_table(table: PointTable | KeyframeTable, other: PointTable | KeyframeTable, order: Indices) -> None:
    first = table.count
    _add_rows(table, len(order))
    for name, array in vars(table).items():
        if isinstance(array, np.ndarray):
            array[first : table.count] = getattr(other, name)[order]


class Views(NamedTuple):
    """The keyframes as compiled code reads them, one a row."""

    poses: Any
    """camera_from_world (K, 4, 4)."""
    centers: Any
    """Camera centers in the world (K, 3)."""
    pixels: Any
    """By feature (K, F, 2)."""
    octaves: Any
    """By feature (K, F)."""
    descriptors: Any
    """By feature (K, F, 4)."""
    points: Any
    """Map point of each feature (K, F), -1 for none."""
    counts: Any
    """Number of features (K,)."""


class KeyframeTable:
    """The keyframes, one a row; the first `count` rows are in use, dead ones (see `alive`) among them.

    `camera_from_world` (K, 4, 4); `centers_world` (K, 3); `octaves`, `pixels`, `descriptors`, `points` (K, F, ...) by
    feature, `points` NONE if a feature has none; `frame_indices` and `parents` (in the spanning tree) (K,); `scales`:
    by how much loop corrections have stretched the surroundings; `features` the Features objects.
    """

    def __init__(self, features_limit: int, capacity: int = 64) -> None:
        self.count = 0
        self.camera_from_world = np.tile(np.eye(4), (capacity, 1, 1))
        self.centers_world = np.zeros((capacity, 3))
        self.pixels = np.zeros((capacity, features_limit, 2))
        self.octaves = np.zeros((capacity, features_limit), np.int32)
        self.descriptors = np.zeros((capacity, features_limit, 4), np.uint64)
        self.points = np.full((capacity, features_limit), NONE, np.int64)
        self.feature_counts = np.zeros(capacity, np.int64)
        self.frame_indices = np.full(capacity, NONE, np.int64)
        self.parents = np.full(capacity, NONE, np.int64)
        self.scales = np.ones(capacity)
        self.alive = np.zeros(capacity, np.bool_)
        self.features: list[Features] = []
        self.timestamps_s: list[float] = []

    def add(self, features: Features, camera_from_world: Array, frame_index: int, timestamp_s: float) -> int:
        """Add a keyframe that sees no point yet; returns its index."""
        k = self.count
        _add_rows(self, 1)
        n = len(features)
        self.pixels[k, :n] = features.pixels
        self.octaves[k, :n] = features.octaves
        self.descriptors[k, :n] = features.descriptors
        self.feature_counts[k] = n
        self.alive[k] = True
        self.frame_indices[k] = frame_index
        self.features.append(features)
        self.timestamps_s.append(timestamp_s)
        self.set_pose(k, camera_from_world)
        return k

    def append(self, other: KeyframeTable, order: Indices) -> None:
        """Add all rows of another table, in `order` (K,), unchanged; see PointTable.append."""
        _append_table(self, other, order)
        self.features += [other.features[k] for k in order]
        self.timestamps_s += [other.timestamps_s[k] for k in order]

    @property
    def views(self) -> Views:
        """The table as compiled code reads it."""
        return Views(
            self.camera_from_world, self.centers_world, self.pixels, self.octaves, self.descriptors, self.points,
            self.feature_counts,
        )  # fmt: skip

    def set_pose(self, keyframe: int | Indices, camera_from_world: Array) -> None:
        """Set one pose (4, 4) or several (N, 4, 4)."""
        self.camera_from_world[keyframe] = camera_from_world
        rotations, translations = camera_from_world[..., :3, :3], camera_from_world[..., :3, 3]
        self.centers_world[keyframe] = -np.einsum("...ji,...j->...i", rotations, translations)
