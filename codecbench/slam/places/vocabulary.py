"""A vocabulary tree of binary descriptors, which turns an image into a bag of words, and their similarity."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.hamming import hamming
from codecbench.slam.geometry.rotations import Array

Indices = NDArray[np.int64]
_DBOW2_HEADER = "10 6 0 0"  # branching, depth, L1 score, tf-idf; readers size by it, so it is the same for any tree


@dataclass(frozen=True)
class BowVector:
    """An image as a bag of words."""

    words: Indices
    """Ascending (n,)."""
    values: Array
    """Their tf-idf (n,), which sum to 1."""

    def score(self, other: BowVector) -> float:
        """Return the similarity of two images, 0..1: 1 - |v - w| / 2 (Galvez-Lopez and Tardos, 2012, equation 2)."""
        _, mine, theirs = np.intersect1d(self.words, other.words, assume_unique=True, return_indices=True)
        return float(np.minimum(self.values[mine], other.values[theirs]).sum())


@dataclass(frozen=True)
class Words:
    """Where descriptors fall in the tree."""

    words: Indices
    """Leaves (N,)."""
    weights: Array
    """Inverse document frequencies (N,)."""
    nodes: Indices
    """Ancestors (N,) at one level."""


class Vocabulary:
    """A tree of binary descriptors whose leaves are words, each with its inverse document frequency.

    Nodes are numbered breadth first from the root, 0. `child_counts` (n,) uint8, 0 at a leaf; `descriptors` (n - 1, 32)
    uint8 of all nodes but the root; `weights` of the leaves, in the order of their nodes. Raises ValueError if these do
    not describe one tree. Source: Galvez-Lopez and Tardos, "Bags of binary words for fast place recognition in image
    sequences", T-RO 28(5), 2012, doi:10.1109/TRO.2012.2197158.
    """

    def __init__(self, child_counts: NDArray[np.uint8], descriptors: NDArray[np.uint8], weights: Array) -> None:
        self.child_counts = np.ascontiguousarray(child_counts, dtype=np.uint8)
        self.descriptors = np.ascontiguousarray(descriptors, dtype=np.uint8)
        self.weights = np.ascontiguousarray(weights, dtype=np.float64)
        count = len(self.child_counts)
        leaves = self.child_counts == 0
        ends = np.cumsum(self.child_counts, dtype=np.int64)
        if count < 2 or ends[-1] != count - 1 or (ends < np.arange(1, count + 1))[:-1].any():
            raise ValueError(f"Vocabulary: the child counts of {count} nodes do not describe one tree")
        if self.descriptors.shape != (count - 1, 32) or self.weights.shape != (int(leaves.sum()),):
            raise ValueError(
                f"Vocabulary: descriptors {self.descriptors.shape} and weights {self.weights.shape}; "
                f"expected ({count - 1}, 32) and ({int(leaves.sum())},)"
            )
        if not (np.isfinite(self.weights).all() and (self.weights >= 0.0).all()):
            raise ValueError("Vocabulary: a weight is negative or not finite")
        self._first_children = ends - self.child_counts + 1
        self._words = np.where(leaves, np.cumsum(leaves) - 1, -1).astype(np.int64)
        self._bits = np.zeros((count, 4), dtype=np.uint64)
        self._bits[1:] = self.descriptors.view(np.uint64)

    def __len__(self) -> int:
        """Return the number of words."""
        return len(self.weights)

    @property
    def parents(self) -> Indices:
        """The parent of each node but the root (n - 1,)."""
        return np.repeat(np.arange(len(self.child_counts)), self.child_counts)

    @staticmethod
    def load(path: Path | Any) -> Vocabulary:
        """Read a vocabulary from an .npz file written by `save`."""
        with np.load(path, allow_pickle=False) as arrays:
            return Vocabulary(arrays["child_counts"], arrays["descriptors"], arrays["weights"])

    @staticmethod
    def load_default() -> Vocabulary:
        """Return the vocabulary that comes with the package; read once, then shared."""
        return _default_vocabulary()

    def save(self, path: Path) -> None:
        """Write the vocabulary to an .npz file."""
        np.savez_compressed(
            path,
            child_counts=self.child_counts,
            descriptors=self.descriptors,
            weights=self.weights.astype(np.float32),
        )

    def words(self, descriptors: NDArray[Any], level: int = 2) -> Words:
        """Return the words of descriptors, (N, 32) uint8 or (N, 4) uint64, and their ancestors at `level`.

        Level 1 is below the root; a leaf above `level` counts as its own ancestor. Raises ValueError for other arrays.
        """
        bits = np.ascontiguousarray(descriptors)
        if bits.dtype == np.uint8 and bits.ndim == 2 and bits.shape[1] == 32:
            bits = bits.view(np.uint64)
        if bits.dtype != np.uint64 or bits.ndim != 2 or bits.shape[1] != 4:
            raise ValueError(
                f"Vocabulary.words: got {bits.dtype} {bits.shape}; expected uint8 (N, 32) or uint64 (N, 4)"
            )
        leaves, nodes = np.empty(len(bits), np.int64), np.empty(len(bits), np.int64)
        _descend(bits, self._bits, self._first_children, self.child_counts, level, leaves, nodes)
        words = self._words[leaves]
        return Words(words, self.weights[words], nodes)

    def bow(self, words: Indices) -> BowVector:
        """Return the bag of the words (N,) of one image: term frequency times idf, scaled to sum to 1.

        Words that every training image had weigh nothing and are left out; no words give an empty bag.
        """
        distinct, counts = np.unique(words, return_counts=True)
        values = counts * self.weights[distinct]
        distinct, values = distinct[values > 0.0], values[values > 0.0]
        return BowVector(distinct, values / values.sum() if len(values) else values)

    def write_dbow2_text(self, path: Path) -> None:
        """Write the tree as DBoW2 reads it: a header, then for each node its parent, leaf flag, 32 bytes and weight.

        The header is `10 6 0 0` whatever the depth: readers take their direct-index level from it.
        """
        weights = np.zeros(len(self.child_counts))
        weights[self.child_counts == 0] = self.weights
        with Path(path).open("w", encoding="ascii", newline="\n") as file:
            file.write(f"{_DBOW2_HEADER}\n")
            for node, (parent, row) in enumerate(zip(self.parents, self.descriptors, strict=True), start=1):
                leaf = int(self.child_counts[node] == 0)
                file.write(f"{parent} {leaf} {' '.join(map(str, row))} {weights[node]:.9g}\n")

    @staticmethod
    def read_dbow2_text(path: Path) -> Vocabulary:
        """Read a tree of 32-byte descriptors in DBoW2's text format; raises ValueError if a line does not fit."""
        with Path(path).open(encoding="ascii") as file:
            file.readline()
            rows = np.loadtxt(file, ndmin=2)
        if rows.shape[1] != 35 or not len(rows):
            raise ValueError(f"{path}: rows of {rows.shape[1]} numbers; expected 35: parent, leaf, 32 bytes, weight")
        parents = rows[:, 0].astype(np.int64)
        if not (parents < np.arange(1, len(rows) + 1)).all() or parents.min() < 0:
            raise ValueError(f"{path}: a node comes before its parent")
        order = [0]  # breadth first; children keep the order of the file
        children: list[list[int]] = [[] for _ in range(len(rows) + 1)]
        for node, parent in enumerate(parents, start=1):
            children[parent].append(node)
        for node in order:
            order.extend(children[node])
        rank = np.array(order[1:]) - 1
        counts = np.array([len(children[node]) for node in order], dtype=np.uint8)
        return Vocabulary(counts, rows[rank, 2:34].astype(np.uint8), rows[rank, 34][counts[1:] == 0])


@lru_cache(maxsize=1)
def _default_vocabulary() -> Vocabulary:
    source = resources.files(__package__).joinpath("vocabulary.npz")
    with resources.as_file(source) as path:
        return Vocabulary.load(path)


@compiled
def _descend(descriptors, nodes, first_children, child_counts, level, leaves, ancestors):  # type: ignore[no-untyped-def]
    """Walk each descriptor down the tree to the nearest child, the first one of equals."""
    for i in range(descriptors.shape[0]):
        node, depth = 0, 0
        ancestors[i] = 0
        while child_counts[node] > 0:
            first = first_children[node]
            best, best_distance = first, 257
            for child in range(first, first + child_counts[node]):
                distance = hamming(descriptors, i, nodes, child)
                if distance < best_distance:
                    best, best_distance = child, distance
            node, depth = best, depth + 1
            if depth <= level:
                ancestors[i] = node
        leaves[i] = node
