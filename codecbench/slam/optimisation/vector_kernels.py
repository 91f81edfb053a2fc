"""The innermost product of the Schur complement, on vector registers.

The compiler leaves a 6 x 6 update in scalars, because it cannot know that the arrays do not overlap. This states it in
vectors of four and two doubles; on any processor the sums are formed in the same order and rounded alike.

What it buys, by tests/benchmarks/test_slam_vector_kernels.py on one x86-64 core: with the same update in plain
numba a local adjustment takes 1.5 times as long, and the adjustment of a map of 150 keyframes 2.1 times.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

_DOUBLE = ir.DoubleType()
_PARTS = ((0, 4), (4, 2))  # first column and width of the vectors that make a row of six


def _subtract_product(
    typing_context: Any, system: Any, start: Any, stride: Any, product: Any, crosses: Any, row: Any
) -> Any:
    """Subtract `product` (6, 3) times `crosses[row]` (M, 3, 6) from the 6 x 6 block of the flat `system` at `start`.

    Rows of the block are `stride` apart. The arrays are contiguous float64, the indices int64, and none is checked.
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
                    total = _multiply_add(builder, rows[k, column], _spread(builder, scales[k], width), total)
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


def _spread(builder: Any, scalar: Any, width: int) -> Any:
    """The vector that holds a scalar in every place."""
    vector = ir.VectorType(_DOUBLE, width)
    single = builder.insert_element(ir.Constant(vector, ir.Undefined), scalar, ir.Constant(ir.IntType(32), 0))
    places = ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width)
    return builder.shuffle_vector(single, single, places)


def _multiply_add(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c, rounded once, on every processor."""
    kind = ir.FunctionType(a.type, [a.type] * 3)
    function = builder.module.declare_intrinsic(f"llvm.fma.v{a.type.count}f64", (), kind)
    return builder.call(function, [a, b, c])
