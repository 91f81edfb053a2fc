"""The profile `context`: from image to bitstream and back."""

from __future__ import annotations

import functools
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import Image
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.dct.planes import crop_plane, image_from_planes, pad_plane, planes_from_image
from codecbench.plugins.codecs.dct.tables import Table
from codecbench.plugins.codecs.multilevel.arithmetic import LOOK_AHEAD
from codecbench.plugins.codecs.multilevel.bitstream import check_end, pad_section
from codecbench.plugins.codecs.multilevel.context.binary import POSITION, finish, new_coder, start_decoding
from codecbench.plugins.codecs.multilevel.context.bitstream import (
    CHROMA_UNITS,
    ContextHeader,
    pack,
    unpack,
    unpack_intact,
)
from codecbench.plugins.codecs.multilevel.context.coefficients import (
    BAD_INDEX,
    MAX_BLOCK_BYTES,
    TRUNCATED,
    code_blocks,
)
from codecbench.plugins.codecs.multilevel.context.contexts import new_statistics
from codecbench.plugins.codecs.multilevel.context.outer import predictors
from codecbench.plugins.codecs.multilevel.context.quantization import (
    USUAL_BIAS,
    biases_from_sums,
    dequantise,
    estimate_costs,
    optimise,
    quantise,
    steps_from_table,
    sum_excesses,
)
from codecbench.plugins.codecs.multilevel.context.transform import forward_transform, inverse_transform

Effort = Literal["fast", "normal", "best"]
Indices = NDArray[np.int32]
T = TypeVar("T")

REACH_ROWS = 10
"""Most rows that a lost slice affects beyond itself, by overlapping blocks in chroma of half the height."""
_OPTIMIZATIONS = 2
_REASONS = {TRUNCATED: "truncated", BAD_INDEX: "an index is out of range"}


def encode(
    image: Image, header: ContextHeader, effort: Effort, trace: Trace = NULL_TRACE, *, threads: int = 1
) -> bytes:
    """Encode an image with the parameters in `header`, whose biases are set here.

    threads: number of slices coded at once, to the same bytes.
    """
    indices = []
    for number, plane in enumerate(planes_from_image(image, header.color, trace)):
        plane = pad_plane(plane, trace=trace)
        chosen, header.biases[number] = _quantize_plane(plane, _steps(header, number), header.lapped, effort, trace)
        indices.append(chosen)
    return pack(
        header,
        _map_slices(range(header.slices), lambda number: _encode_slice(header, number, indices, trace), threads, trace),
    )


def decode(bitstream: bytes, trace: Trace = NULL_TRACE, *, threads: int = 1) -> Image:
    """Decode a bitstream, `threads` slices at once. Raises BitstreamError for damaged or foreign bytes."""
    header, payloads = unpack(bitstream)
    indices = _zero_indices(header)
    _map_slices(
        range(header.slices),
        lambda number: _decode_slice(header, number, payloads[number], indices, trace),
        threads,
        trace,
    )
    return _reconstruct(header, indices, trace)


def _map_slices(numbers: range, work: Callable[[int], T], threads: int, trace: Trace) -> list[T]:
    """Apply `work` to each slice; one after another if operations are counted, because the counters are shared."""
    threads = min(threads, len(numbers)) if trace is NULL_TRACE else 1
    if threads == 1:
        return [work(number) for number in numbers]
    with ThreadPoolExecutor(threads) as pool:
        return list(pool.map(work, numbers))


@dataclass(frozen=True)
class SalvagedImage:
    """The decodable part of a damaged bitstream."""

    image: Image
    lost: list[range]
    """Rows of pixels that were not decode."""


def salvage(bitstream: bytes) -> SalvagedImage:
    """Decode a damaged bitstream; damaged slices are gray.

    Damage in a slice affects up to REACH_ROWS rows beyond it, by overlapping blocks. Raises BitstreamError if the
    header is damaged, or there are no restart points.
    """
    header, payloads = unpack_intact(bitstream)
    indices = _zero_indices(header)
    lost = []
    for number, payload in enumerate(payloads):
        if payload is None:
            rows = header.block_rows(0, number)
            lost.append(range(8 * rows.start, min(8 * rows.stop, header.height)))
        else:
            _decode_slice(header, number, payload, indices, NULL_TRACE)
    return SalvagedImage(_reconstruct(header, indices, NULL_TRACE), lost)


def _steps(header: ContextHeader, plane: int) -> NDArray[np.int64]:
    factor = header.qf * (header.chroma / CHROMA_UNITS if plane else 1.0)
    return steps_from_table(header.table, factor, header.lapped)


def _quantize_plane(
    plane: NDArray[np.uint8], steps: NDArray[np.int64], lapped: bool, effort: Effort, trace: Trace
) -> tuple[Indices, NDArray[np.int32]]:
    """Quantize a padded plane to indices (n + 1, 64) in natural order; returns them and the reconstruction biases."""
    coefficients = np.empty((plane.size // 64, 64), np.int32)
    indices = np.empty((len(coefficients) + 1, 64), np.int32)
    indices[-1] = 0
    columns = plane.shape[1] // 8
    with trace.stage("lapped_transform" if lapped else "dct") as run:
        run(forward_transform, plane, int(lapped), coefficients)
    with trace.stage("quantization") as run:
        run(quantise, coefficients, steps, indices)
    if effort == "best":
        with trace.stage("optimization") as run:
            costs = np.empty((66, 8, 2), np.int64)
            for _ in range(_OPTIMIZATIONS):
                run(estimate_costs, indices, columns, costs)
                run(optimise, coefficients, steps, columns, costs, indices)
    if effort == "fast":
        return indices, np.full((3, 3), USUAL_BIAS, np.int32)
    with trace.stage("centroids") as run:
        sums = np.zeros((3, 3, 2), np.int64)
        run(sum_excesses, coefficients, steps, indices, sums)
    return indices, biases_from_sums(sums)


def _encode_slice(header: ContextHeader, number: int, indices: list[Indices], trace: Trace) -> bytes:
    """Encode the payload of a slice."""
    room = header.slice_samples(number) + 2 * MAX_BLOCK_BYTES
    while True:
        data = np.empty(room, np.uint8)
        coder = new_coder(header.mixing, room - MAX_BLOCK_BYTES)
        with trace.stage("context_coding") as run:
            result = 0
            statistics = [new_statistics(chroma) for chroma in (False, True)]
            for plane, plane_indices in enumerate(indices):
                part = _part(header, plane, number)
                result = result or run(code_blocks, coder, data, *statistics[plane > 0], plane_indices, *part)
            if not result:
                return pad_section(data[: run(finish, coder, data)].tobytes(), header.slice_samples(number))
        room *= 4


def _decode_slice(header: ContextHeader, number: int, payload: bytes, indices: list[Indices], trace: Trace) -> None:
    """Decode a payload into its part of `indices`. Raises BitstreamError for bits that no encoder writes."""
    data = np.frombuffer(bytearray(payload), np.uint8)  # writable, so that encoding and decoding share a signature
    coder = new_coder(header.mixing, len(payload) + LOOK_AHEAD)
    with trace.stage("context_decoding") as run:
        run(start_decoding, coder, data)
        statistics = [new_statistics(chroma) for chroma in (False, True)]
        for plane, plane_indices in enumerate(indices):
            part = _part(header, plane, number)
            result = run(code_blocks, coder, data, *statistics[plane > 0], plane_indices, *part)
            if result:
                raise BitstreamError(f"slice {number}, plane {plane}: {_REASONS[result]}")
    check_end(payload, int(coder[POSITION]), header.slice_samples(number), f"slice {number}")


def _part(header: ContextHeader, plane: int, number: int) -> tuple[int, int, int, NDArray[np.int64], NDArray[np.int64]]:
    """Return a plane's blocks in a slice, first and number, blocks in a row, and the predictors."""
    rows, columns = header.block_rows(plane, number), header.padded_shapes[plane][1] // 8
    return rows.start * columns, len(rows) * columns, columns, *_predictors(header.table.tobytes(), header.lapped)


@functools.lru_cache(maxsize=8)
def _predictors(table: bytes, lapped: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    steps: Table = np.frombuffer(table, np.int32).reshape(8, 8)
    return predictors(steps, lapped)


def _zero_indices(header: ContextHeader) -> list[Indices]:
    """Allocate zero indices for every plane, with a last row for blocks outside."""
    return [np.zeros((height * width // 64 + 1, 64), np.int32) for height, width in header.padded_shapes]


def _reconstruct(header: ContextHeader, indices: list[Indices], trace: Trace) -> Image:
    planes = []
    for number, (shape, padded_shape) in enumerate(zip(header.plane_shapes, header.padded_shapes, strict=True)):
        coefficients = np.empty((len(indices[number]) - 1, 64), np.int32)
        plane = np.empty(padded_shape, np.uint8)
        with trace.stage("dequantization") as run:
            run(dequantise, indices[number], _steps(header, number), header.biases[number], coefficients)
        with trace.stage("inverse_lapped_transform" if header.lapped else "idct") as run:
            run(inverse_transform, coefficients, int(header.lapped), plane)
        planes.append(crop_plane(plane, shape, trace))
    return image_from_planes(planes, header.color, header.channels, trace)
