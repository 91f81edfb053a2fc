"""The Schur complement of bundle adjustment: eliminates the points, and finds their steps by back substitution.

Nothing here checks an index: `bundle_adjustment.adjust` has done so.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.geometry.rotations import so3_exp_into

MIN_DAMPING = 1e-9


class Layout(NamedTuple):
    """Layout of the reduced camera system."""

    slots: Any
    """Position of each camera's parameters (K,), -1 if fixed."""
    first: Any
    """Envelope of the system: first column block of each row."""
    offsets: Any
    """Envelope of the system: where each block row begins."""


class Workspace(NamedTuple):
    """Arrays that one step fills: the first three by linearization, the others by elimination."""

    normals: Any
    """Block V (upper triangle) and gradient of each point (P, 9)."""
    blocks: Any
    """Block U (lower triangle) and gradient of each free camera (n, 27)."""
    crosses: Any
    """Cross term W of each observation (M, 3, 6), point by camera."""
    inverses: Any
    """Damped inverses of the points' blocks (P, 6)."""
    system: Any
    """The reduced camera system, a flat envelope."""
    right_side: Any
    """Its right side (6 n,)."""


@compiled
def eliminate(seen, layout, damping, work):  # type: ignore[no-untyped-def]
    """Fill the reduced camera system S = U - W V^-1 W^T, damped, its right side, and V^-1 of each point."""
    slots, first, offsets = layout
    system, right_side = work.system, work.right_side
    system[:] = 0.0
    for i in range(first.shape[0]):
        stride, k, block = 6 * (i - first[i] + 1), 0, work.blocks[i]
        for a in range(6):
            row = offsets[i] + a * stride + stride - 6
            for b in range(a + 1):
                system[row + b] = block[k]
                k += 1
            diagonal = system[row + a]
            system[row + a] = diagonal * (1.0 + damping) if diagonal > 0.0 else 1.0
            right_side[6 * i + a] = block[21 + a]
    product = np.empty((6, 3))
    for p in range(work.normals.shape[0]):
        if _invert_damped(work.normals[p], max(damping, MIN_DAMPING), work.inverses[p]):
            _eliminate_point(
                work.inverses[p], work.normals[p], seen.starts[p], seen.starts[p + 1], seen.cameras,
                seen.active, slots, first, offsets, work.crosses, system, right_side, product,
            )  # fmt: skip


@compiled(error_model="numpy")
def _invert_damped(normal, damping, out):  # type: ignore[no-untyped-def]
    """Write the inverse (xx, xy, xz, yy, yz, zz) of a point's damped block; zeros and False if it has none."""
    xy, xz, yz = normal[1], normal[2], normal[4]
    xx, yy, zz = normal[0] * (1.0 + damping), normal[3] * (1.0 + damping), normal[5] * (1.0 + damping)
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * c0 + xy * c1 + xz * c2
    if not determinant > 1e-16 * xx * yy * zz:
        out[:] = 0.0
        return False
    out[0], out[1], out[2] = c0 / determinant, c1 / determinant, c2 / determinant
    out[3] = (xx * zz - xz * xz) / determinant
    out[4] = (xy * xz - xx * yz) / determinant
    out[5] = (xx * yy - xy * xy) / determinant
    return True


@compiled
def _eliminate_point(  # type: ignore[no-untyped-def]
    inverse, normal, start, end, cameras, active, slots, first, offsets, crosses, system, right_side, product
):
    """Subtract W V^-1 W^T of one point from the system, block by block, and W V^-1 g from the right side."""
    i0, i1, i2, i3, i4, i5 = inverse[0], inverse[1], inverse[2], inverse[3], inverse[4], inverse[5]
    g0, g1, g2 = normal[6], normal[7], normal[8]
    for m in range(start, end):
        slot = slots[cameras[m]]
        if slot < 0 or not active[m]:
            continue
        cross, row, stride = crosses[m], offsets[slot] - 6 * first[slot], 6 * (slot - first[slot] + 1)
        for a in range(6):
            w0, w1, w2 = cross[0, a], cross[1, a], cross[2, a]
            y0 = product[a, 0] = w0 * i0 + w1 * i1 + w2 * i2
            y1 = product[a, 1] = w0 * i1 + w1 * i3 + w2 * i4
            y2 = product[a, 2] = w0 * i2 + w1 * i4 + w2 * i5
            right_side[6 * slot + a] -= y0 * g0 + y1 * g1 + y2 * g2
        for n in range(start, m + 1):
            other = slots[cameras[n]]
            if other >= 0 and active[n]:
                subtract_product(system, row + 6 * other, stride, product, crosses, n)


@compiled
def move_cameras(poses, slots, step, out):  # type: ignore[no-untyped-def]
    """Write the left update of each free camera's pose to `out`."""
    rotation = np.empty((3, 3))
    for k in range(poses.shape[0]):
        if slots[k] < 0:
            continue
        update, pose = step[6 * slots[k] :], poses[k]
        so3_exp_into(update[3], update[4], update[5], rotation)
        for i in range(3):
            for j in range(4):
                out[k, i, j] = rotation[i, 0] * pose[0, j] + rotation[i, 1] * pose[1, j] + rotation[i, 2] * pose[2, j]
            out[k, i, 3] += update[i]


@compiled
def move_points(points, seen, slots, work, out):  # type: ignore[no-untyped-def]
    """Back substitution: each point's step is V^-1 (g - W^T step of the cameras)."""
    cameras, starts, _, _, active, _ = seen
    inverses, normals, crosses, steps = work.inverses, work.normals, work.crosses, work.right_side
    for p in range(points.shape[0]):
        inverse, normal = inverses[p], normals[p]
        g0, g1, g2 = normal[6], normal[7], normal[8]
        if inverse[0] != 0.0:  # else the point stays
            for m in range(starts[p], starts[p + 1]):
                slot = slots[cameras[m]]
                if slot >= 0 and active[m]:
                    cross, step = crosses[m], steps[6 * slot : 6 * slot + 6]
                    for a in range(6):
                        g0 -= cross[0, a] * step[a]
                        g1 -= cross[1, a] * step[a]
                        g2 -= cross[2, a] * step[a]
        out[p, 0] = points[p, 0] + inverse[0] * g0 + inverse[1] * g1 + inverse[2] * g2
        out[p, 1] = points[p, 1] + inverse[1] * g0 + inverse[3] * g1 + inverse[4] * g2
        out[p, 2] = points[p, 2] + inverse[2] * g0 + inverse[4] * g1 + inverse[5] * g2


_DOUBLE = ir.DoubleType()
_PARTS = ((0, 4), (4, 2))  # first column and width of the vectors that make a row of six


# The innermost product, in vector instructions ----------------------------------------------------------------------


def _subtract_product(
    typing_context: Any, system: Any, start: Any, stride: Any, product: Any, crosses: Any, row: Any
) -> Any:
    """Subtract `product` (6, 3) times `crosses[row]` (M, 3, 6) from the 6 x 6 block of the flat `system` at `start`.

    Rows of the block are `stride` apart. The arrays are contiguous float64, the indices int64, and none is checked.

    The compiler leaves a 6 x 6 update in scalars, because it cannot know that the arrays do not overlap. This function
    states it in vectors of four and two doubles. Every processor forms the sums in one order and rounds them alike.

    The gain, by tests/benchmarks/test_slam_vector_kernels.py on one x86-64 core: with the same update in plain numba a
    local adjustment takes 1.5 times as long, and the adjustment of a map of 150 keyframes 2.1 times.
    """

    def build(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        arrays = [
            context.make_array(kind)(context, builder, value).data
            for kind, value in zip(signature.args, arguments, strict=True)
            if isinstance(kind, types.Array)
        ]
        target, factors, cross = arrays
        first = builder.mul(arguments[5], ir.Constant(ir.IntType(64), 18))
        cross = builder.gep(cross, [first])
        rows = {(k, c): _load(builder, cross, 6 * k + c, width) for k in range(3) for c, width in _PARTS}
        place = builder.gep(target, [arguments[1]])
        for a in range(6):
            scales = [builder.fneg(builder.load(_at(builder, factors, 3 * a + k))) for k in range(3)]
            for column, width in _PARTS:
                pointer = _vector_pointer(builder, place, column, width)
                total = builder.load(pointer, align=8)
                for k in range(3):
                    total = _multiply_add(builder, rows[k, column], _broadcast(builder, scales[k], width), total)
                builder.store(total, pointer, align=8)
            place = builder.gep(place, [arguments[2]])
        return context.get_dummy_value()

    return types.void(system, types.int64, types.int64, product, crosses, types.int64), build


subtract_product: Any = intrinsic(_subtract_product)


def _at(builder: Any, pointer: Any, index: int) -> Any:
    return builder.gep(pointer, [ir.Constant(ir.IntType(64), index)])


def _vector_pointer(builder: Any, pointer: Any, index: int, width: int) -> Any:
    return builder.bitcast(_at(builder, pointer, index), ir.VectorType(_DOUBLE, width).as_pointer())


def _load(builder: Any, pointer: Any, index: int, width: int) -> Any:
    return builder.load(_vector_pointer(builder, pointer, index, width), align=8)


def _broadcast(builder: Any, scalar: Any, width: int) -> Any:
    """Return the vector that holds a scalar in every place."""
    vector = ir.VectorType(_DOUBLE, width)
    single = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return builder.shuffle_vector(single, single, places)


def _multiply_add(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """Return a b + c, rounded once, on every processor."""
    kind = ir.FunctionType(a.type, [a.type] * 3)
    function = builder.module.declare_intrinsic(f"llvm.fma.v{a.type.count}f64", (), kind)
    return builder.call(function, [a, b, c])
