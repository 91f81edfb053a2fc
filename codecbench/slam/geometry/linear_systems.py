"""Symmetric linear systems of the solvers: a small dense one, and a large one with blocks under an envelope.

LAPACK is not used, because the sums must come in one order whatever the number of BLAS threads, so that a run is
repeated to the last bit. The whole iteration then also stays in compiled code.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from codecbench.core.kernels.compiled import compiled

Indices = NDArray[np.int64]


@compiled
def copy_numbers(source, target):  # type: ignore[no-untyped-def]
    """Copy an array into one of its shape, both contiguous; assigning a slice would take seconds to compile."""
    source, target = source.reshape(-1), target.reshape(-1)
    for i in range(source.shape[0]):
        target[i] = source[i]


@compiled
def solve_symmetric(matrix, right_side, damping):  # type: ignore[no-untyped-def]
    """Return x of (A + damping diag(A)) x = b and whether A was positive definite; reads the lower triangle only."""
    n = right_side.shape[0]
    factor, x = np.empty((n, n)), right_side.copy()
    for i in range(n):
        for j in range(i + 1):
            value = matrix[i, j]
            if i == j:
                value *= 1.0 + damping
            for k in range(j):
                value -= factor[i, k] * factor[j, k]
            if i > j:
                factor[i, j] = value / factor[j, j]
            elif value > 1e-13 * matrix[i, i]:
                factor[i, i] = math.sqrt(value)
            else:
                return x, False
    for i in range(n):
        for k in range(i):
            x[i] -= factor[i, k] * x[k]
        x[i] /= factor[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            x[i] -= factor[k, i] * x[k]
        x[i] /= factor[i, i]
    return x, True


def envelope_order(adjacency: NDArray[np.bool_]) -> Indices:
    """Return the order (n,) of a graph's nodes with the smaller envelope: the given one or Cuthill-McKee's.

    `adjacency` (n, n) is symmetric. `order[k]` is the node at position k. Sources: Cuthill and McKee, 1969; George,
    1971.
    """
    natural = np.arange(len(adjacency), dtype=np.int64)
    if len(natural) < 3:
        return natural
    reverse = reverse_cuthill_mckee(csr_array(adjacency), symmetric_mode=True).astype(np.int64)
    sizes = [int((natural - first_neighbors(adjacency[np.ix_(o, o)])).sum()) for o in (natural, reverse)]
    return natural if sizes[0] <= sizes[1] else reverse


def first_neighbors(adjacency: NDArray[np.bool_]) -> Indices:
    """Return for each node (n,) the first position that it is joined to, or its own."""
    if not len(adjacency):
        return np.zeros(0, dtype=np.int64)
    linked = adjacency | np.eye(len(adjacency), dtype=np.bool_)
    first: Indices = np.argmax(linked, axis=1).astype(np.int64)
    return first


def envelope_offsets(first: Indices, block: int) -> Indices:
    """Return where each block row begins (n + 1,) in the flat storage of a matrix with this envelope.

    Block row i holds its blocks first[i]..i side by side: `block` rows, each block (i - first[i] + 1) long.
    """
    widths = np.arange(len(first)) - first + 1
    return np.concatenate([[0], np.cumsum(widths * block * block)]).astype(np.int64)


@compiled
def _dot_3x3(values, row_a, stride_a, row_b, stride_b, length, out):  # type: ignore[no-untyped-def]
    """Write the products of three rows with three rows: nine sums that share their loads."""
    s00 = s01 = s02 = s10 = s11 = s12 = s20 = s21 = s22 = 0.0
    a0, a1, a2 = values[row_a:], values[row_a + stride_a :], values[row_a + 2 * stride_a :]
    b0, b1, b2 = values[row_b:], values[row_b + stride_b :], values[row_b + 2 * stride_b :]
    for k in range(length):
        x, y, z = b0[k], b1[k], b2[k]
        s00 += a0[k] * x
        s01 += a0[k] * y
        s02 += a0[k] * z
        s10 += a1[k] * x
        s11 += a1[k] * y
        s12 += a1[k] * z
        s20 += a2[k] * x
        s21 += a2[k] * y
        s22 += a2[k] * z
    out[0, 0], out[0, 1], out[0, 2] = s00, s01, s02
    out[1, 0], out[1, 1], out[1, 2] = s10, s11, s12
    out[2, 0], out[2, 1], out[2, 2] = s20, s21, s22


@compiled
def _dot(values, row_a, row_b, length):  # type: ignore[no-untyped-def]
    total = 0.0
    a, b = values[row_a:], values[row_b:]
    for k in range(length):
        total += a[k] * b[k]
    return total


@compiled
def _subtract_products(values, row_a, stride_a, row_b, stride_b, length, target, block, tile):  # type: ignore[no-untyped-def]
    """Subtract A B^T (block rows each, `length` columns) from the block at `target`, in tiles of 3 x 3."""
    whole = block - block % 3
    for i in range(0, whole, 3):
        for j in range(0, whole, 3):
            _dot_3x3(values, row_a + i * stride_a, stride_a, row_b + j * stride_b, stride_b, length, tile)
            for a in range(3):
                for b in range(3):
                    values[target + (i + a) * stride_a + j + b] -= tile[a, b]
    for i in range(block):
        for j in range(whole if i < whole else 0, block):
            values[target + i * stride_a + j] -= _dot(values, row_a + i * stride_a, row_b + j * stride_b, length)


@compiled
def factorize_envelope(values, first, offsets, block):  # type: ignore[no-untyped-def]
    """Replace a matrix under an envelope (lower triangle, flat) by its Cholesky factor; return whether it exists.

    Row-wise bordering (George and Liu, 1981, chapter 4) on blocks: no fill outside the envelope.
    """
    tile = np.empty((3, 3))
    for i in range(first.shape[0]):
        stride_i = block * (i - first[i] + 1)
        for j in range(first[i], i + 1):
            stride_j = block * (j - first[j] + 1)
            start = max(first[i], first[j])
            row_i, row_j = offsets[i] + block * (start - first[i]), offsets[j] + block * (start - first[j])
            target, diagonal = offsets[i] + block * (j - first[i]), offsets[j] + block * (j - first[j])
            length = block * (j - start)
            if length > 0:
                _subtract_products(values, row_i, stride_i, row_j, stride_j, length, target, block, tile)
            if j < i:
                _solve_block(values, target, stride_i, diagonal, stride_j, block)
            elif not _factorize_block(values, target, stride_i, block):
                return False
    return True


@compiled
def _solve_block(values, target, stride, diagonal, stride_diagonal, block):  # type: ignore[no-untyped-def]
    for a in range(block):
        for b in range(block):
            value = values[target + a * stride + b]
            for k in range(b):
                value -= values[target + a * stride + k] * values[diagonal + b * stride_diagonal + k]
            values[target + a * stride + b] = value / values[diagonal + b * stride_diagonal + b]


@compiled
def _factorize_block(values, target, stride, block):  # type: ignore[no-untyped-def]
    for a in range(block):
        for b in range(a + 1):
            value = values[target + a * stride + b]
            for k in range(b):
                value -= values[target + a * stride + k] * values[target + b * stride + k]
            if a > b:
                values[target + a * stride + b] = value / values[target + b * stride + b]
            elif value > 0.0 and value < np.inf:
                values[target + a * stride + a] = math.sqrt(value)
            else:
                return False
    return True


@compiled
def solve_envelope(values, first, offsets, block, x):  # type: ignore[no-untyped-def]
    """Replace `x` (n block,) by the solution of L L^T x = b, for a factor from `factorize_envelope`."""
    for i in range(first.shape[0]):
        stride, left = block * (i - first[i] + 1), block * first[i]
        for a in range(block):
            row, n = offsets[i] + a * stride, block * (i - first[i]) + a
            value = x[block * i + a]
            for k in range(n):
                value -= values[row + k] * x[left + k]
            x[block * i + a] = value / values[row + n]
    for i in range(first.shape[0] - 1, -1, -1):
        stride, left = block * (i - first[i] + 1), block * first[i]
        for a in range(block - 1, -1, -1):
            row, n = offsets[i] + a * stride, block * (i - first[i]) + a
            value = x[block * i + a] / values[row + n]
            x[block * i + a] = value
            for k in range(n):
                x[left + k] -= values[row + k] * value
