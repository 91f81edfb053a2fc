"""A scan from blocks and blocks from a scan: tables chosen, buffers sized, kernels run, errors named."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.counting.trace import Trace
from codecbench.plugins.codecs.jpeg_qf import entropy
from codecbench.plugins.codecs.jpeg_qf.huffman_tables import (
    STANDARD_TABLES,
    HuffmanTable,
    decoding_tables,
    encoding_tables,
    optimal_table,
)
from codecbench.plugins.codecs.jpeg_qf.interchange import CodedPicture
from codecbench.plugins.codecs.jpeg_qf.scan_layout import ScanLayout

Selectors = tuple[tuple[int, int], ...]
Tables = dict[tuple[int, int], HuffmanTable]


def write_scan(
    blocks: NDArray[np.int32], layout: ScanLayout, selectors: Selectors, optimize: bool, trace: Trace
) -> tuple[Tables, bytes]:
    """The Huffman tables used and the entropy-coded segment of (N, 64) blocks in zigzag order."""
    chosen = np.array(selectors, np.int64)
    keys = sorted({(kind, pair[kind]) for pair in selectors for kind in (0, 1)})
    with trace.stage("huffman") as run:
        if optimize:
            frequencies = np.zeros((2, 2, 256), np.int64)
            run(entropy.count_symbols, blocks, layout.order, layout.pattern, chosen, frequencies)
            tables = {key: optimal_table(frequencies[key], run) for key in keys}
        else:
            tables = {key: STANDARD_TABLES[key] for key in keys}
        codes = encoding_tables(tables)
        output = np.empty(entropy.MAX_BLOCK_BYTES * len(blocks), np.uint8)
        size = run(
            entropy.encode_scan, blocks, layout.order, layout.pattern, chosen, codes.codes, codes.lengths, output
        )
    return tables, output[:size].tobytes()


def read_scan(picture: CodedPicture, layout: ScanLayout, trace: Trace) -> NDArray[np.int32]:
    """(N, 64) blocks in zigzag order. Raises BitstreamError, with the reason, where the data is not a scan."""
    per_mcu = len(layout.pattern)
    interval_mcus = picture.restart_interval or layout.mcus
    ends = np.zeros(-(-layout.mcus // interval_mcus), np.int64)
    stuffed = np.frombuffer(picture.scan_data, np.uint8)
    data = np.zeros(len(stuffed) + entropy.PADDING_BYTES, np.uint8)
    blocks = np.zeros((len(layout.order), 64), np.int32)
    chosen = np.array(picture.selectors, np.int64)
    tables = decoding_tables(picture.huffman_tables)
    arrays = (tables.lookahead, tables.max_codes, tables.offsets, tables.symbols)
    with trace.stage("huffman") as run:
        status = entropy.OK if run(entropy.unstuff, stuffed, data, ends) == len(ends) else entropy.BAD_RESTART
        if status == entropy.OK:
            interval_blocks = interval_mcus * per_mcu
            status = run(
                entropy.decode_scan, data, ends, interval_blocks, layout.order, layout.pattern, chosen, arrays, blocks
            )
    if status != entropy.OK:
        raise BitstreamError(f"jpeg_qf: {entropy.REASONS[status]}")
    return blocks
