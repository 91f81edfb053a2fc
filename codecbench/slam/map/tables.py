"""The tables of the map: points and keyframes, one a row, in arrays that grow."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from codecbench.slam.features.extractor import Features
from codecbench.slam.geometry.rotations import Array

Indices = NDArray[np.int64]
NONE = -1
"""The index of no point or no keyframe."""


def grown(array: NDArray[Any], rows: int, fill: Any) -> NDArray[Any]:
    """`array` with at least `rows` rows, twice as many as before when it must grow; new ones hold `fill`."""
    if rows <= len(array):
        return array
    shape = max(2 * len(array), rows), *array.shape[1:]
    # Zeros cost nothing before their memory is used; to fill 15 MB takes longer than to track a frame.
    longer = np.full(shape, fill, array.dtype) if fill else np.zeros(shape, array.dtype)
    longer[: len(array)] = array
    return longer


class PointTable:
    """The points, one a row: `count` rows are in use, dead ones among them (`alive`).

    `positions`, `normals` (mean viewing direction) (P, 3) in the world; `min_distances`, `max_distances` at which the
    pyramid can show the point; `descriptors` (P, 4); `visible` and `found`: frames that should see and do see it;
    `born`: number of keyframes made before it; `references`: keyframe whose view gave its scale; `replaced_by`: the
    point that took its place, or NONE.
    """

    def __init__(self, capacity: int = 4096) -> None:
        self.count = 0
        self.positions = np.zeros((capacity, 3))
        self.normals = np.zeros((capacity, 3))
        self.min_distances = np.zeros(capacity)
        self.max_distances = np.zeros(capacity)
        self.descriptors = np.zeros((capacity, 4), np.uint64)
        self.alive = np.zeros(capacity, np.bool_)
        self.visible = np.zeros(capacity, np.int64)
        self.found = np.zeros(capacity, np.int64)
        self.born = np.zeros(capacity, np.int64)
        self.references = np.full(capacity, NONE, np.int64)
        self.replaced_by = np.full(capacity, NONE, np.int64)
        self.heads = np.full(capacity, NONE, np.int64)
        self.observation_counts = np.zeros(capacity, np.int64)

    def add(self, positions: Array, reference: int, born: int) -> Indices:
        """New points at `positions` (N, 3); returns their indices (N,)."""
        added = np.arange(self.count, self.count + len(positions))
        _grow(self, len(positions))
        self.positions[added] = positions
        self.alive[added] = True
        self.visible[added] = self.found[added] = 1
        self.born[added], self.references[added] = born, reference
        return added

    def append(self, other: PointTable) -> None:
        """Add all rows of another table as they are: what they say of other rows is for the caller to mend."""
        _append_rows(self, other, np.arange(other.count))


_FILLS = {"references": NONE, "replaced_by": NONE, "heads": NONE, "points": NONE, "frame_indices": NONE,
          "parents": NONE, "scales": 1.0}  # fmt: skip
"""What the columns of rows hold that are not in use yet, where it is not 0."""


def _grow(table: PointTable | KeyframeTable, rows: int) -> None:
    """Take `rows` more rows into use."""
    table.count += rows
    for name, array in vars(table).items():
        if isinstance(array, np.ndarray):
            setattr(table, name, grown(array, table.count, _FILLS.get(name, 0)))


def _append_rows(table: PointTable | KeyframeTable, other: PointTable | KeyframeTable, order: Indices) -> None:
    first = table.count
    _grow(table, len(order))
    for name, array in vars(table).items():
        if isinstance(array, np.ndarray):
            array[first : table.count] = getattr(other, name)[order]


class Views(NamedTuple):
    """The keyframes, one a row: `poses` (K, 4, 4) camera_from_world, `centers` (K, 3) in the world; by feature `pixels`
    (K, F, 2), `octaves` (K, F), `descriptors` (K, F, 4) and map `points` (K, F), -1 for none; `counts` (K,) of
    features."""

    poses: Any
    centers: Any
    pixels: Any
    octaves: Any
    descriptors: Any
    points: Any
    counts: Any


class KeyframeTable:
    """The keyframes, one a row: `count` rows are in use, dead ones among them (`alive`).

    `camera_from_world` (K, 4, 4); `centers_world` (K, 3); `octaves`, `pixels`, `descriptors`, `points` (K, F, ...) by
    feature, `points` NONE where a feature has none; `frame_indices` and `parents` (in the spanning tree) (K,);
    `scales`: by how much loop corrections have stretched the neighbourhood; `features` the Features objects.
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
        """A new keyframe that sees no point yet; returns its index."""
        k = self.count
        _grow(self, 1)
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
        """Add all rows of another table, in `order` (K,), as they are: see PointTable.append."""
        _append_rows(self, other, order)
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
