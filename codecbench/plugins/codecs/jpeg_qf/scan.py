"""Write a scan from blocks and read blocks from a scan: coding order, tables, buffers and errors."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.counting.trace import Trace
from codecbench.plugins.codecs.jfif import FrameHeader
from codecbench.plugins.codecs.jpeg_qf import entropy
from codecbench.plugins.codecs.jpeg_qf.huffman_tables import (
    STANDARD_TABLES,
    HuffmanTable,
    decoding_tables,
    encoding_tables,
    optimal_table,
)
from codecbench.plugins.codecs.jpeg_qf.interchange import CodedPicture

Selectors = tuple[tuple[int, int], ...]
Tables = dict[tuple[int, int], HuffmanTable]


@dataclass(frozen=True)
class ScanLayout:
    """Positions and coding order of the blocks (ITU-T T.81 A.2).

    Blocks lie one component after another, each in raster order.
    """

    grids: tuple[tuple[int, int], ...]
    """Rows and columns of blocks of each component, in whole MCUs."""
    order: NDArray[np.int32]
    """(N,): the blocks in coding order."""
    pattern: NDArray[np.int32]
    """(M,): the component of each of the M blocks of an MCU."""

    @property
    def mcus(self) -> int:
        return len(self.order) // len(self.pattern)


def scan_layout(header: FrameHeader) -> ScanLayout:
    """Return the layout of a frame's only scan: interleaved, or block by block if there is one component."""
    sampling = tuple((component.h, component.v) for component in header.components)
    return _layout(header.width, header.height, sampling if len(sampling) > 1 else ((1, 1),))


@lru_cache(maxsize=8)
def _layout(width: int, height: int, sampling: tuple[tuple[int, int], ...]) -> ScanLayout:
    mcu_rows = -(-height // (8 * max(v for _, v in sampling)))
    mcu_columns = -(-width // (8 * max(h for h, _ in sampling)))
    grids, orders, first = [], [], 0
    for h, v in sampling:
        rows, columns = mcu_rows * v, mcu_columns * h
        indices = np.arange(first, first + rows * columns, dtype=np.int32)
        by_mcu = indices.reshape(mcu_rows, v, mcu_columns, h).transpose(0, 2, 1, 3)
        orders.append(by_mcu.reshape(mcu_rows * mcu_columns, v * h))
        grids.append((rows, columns))
        first += rows * columns
    pattern = np.repeat(np.arange(len(sampling), dtype=np.int32), [h * v for h, v in sampling])
    return ScanLayout(tuple(grids), np.concatenate(orders, axis=1).reshape(-1), pattern)


def write_scan(
    blocks: NDArray[np.int32], layout: ScanLayout, selectors: Selectors, optimize: bool, trace: Trace
) -> tuple[Tables, bytes]:
    """Encode (N, 64) blocks in zigzag order; returns the Huffman tables and the entropy-coded segment."""
    selected = np.array(selectors, np.int64)
    used = sorted({(kind, pair[kind]) for pair in selectors for kind in (0, 1)})
    with trace.stage("huffman") as run:
        if optimize:
            frequencies = np.zeros((2, 2, 256), np.int64)
            run(entropy.count_symbols, blocks, layout.order, layout.pattern, selected, frequencies)
            tables = {key: optimal_table(frequencies[key], run) for key in used}
        else:
            tables = {key: STANDARD_TABLES[key] for key in used}
        codes = encoding_tables(tables)
        output = np.empty(entropy.MAX_BLOCK_BYTES * len(blocks), np.uint8)
        size = run(
            entropy.encode_scan, blocks, layout.order, layout.pattern, selected, codes.codes, codes.lengths, output
        )
    return tables, output[:size].tobytes()


def read_scan(picture: CodedPicture, layout: ScanLayout, trace: Trace) -> NDArray[np.int32]:
    """Decode (N, 64) blocks in zigzag order. Raises BitstreamError with the reason if the data is not a scan."""
    per_mcu = len(layout.pattern)
    interval_mcus = picture.restart_interval or layout.mcus
    ends = np.zeros(-(-layout.mcus // interval_mcus), np.int64)
    stuffed = np.frombuffer(picture.scan_data, np.uint8)
    data = np.zeros(len(stuffed) + entropy.PADDING_BYTES, np.uint8)
    blocks = np.zeros((len(layout.order), 64), np.int32)
    selected = np.array(picture.selectors, np.int64)
    tables = decoding_tables(picture.huffman_tables)
    arrays = (tables.lookahead, tables.max_codes, tables.offsets, tables.symbols)
    with trace.stage("huffman") as run:
        status = entropy.OK if run(entropy.unstuff, stuffed, data, ends) == len(ends) else entropy.BAD_RESTART
        if status == entropy.OK:
            interval_blocks = interval_mcus * per_mcu
            status = run(
                entropy.decode_scan,
                data,
                ends,
                interval_blocks,
                layout.order,
                layout.pattern,
                selected,
                arrays,
                blocks,
            )
    if status != entropy.OK:
        raise BitstreamError(f"jpeg_qf: {entropy.REASONS[status]}")
    return blocks
