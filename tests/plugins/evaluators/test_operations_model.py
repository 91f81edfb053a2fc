"""The closed formulas against every cell and total of the paper's Tables 4, 5 and 6.

Salih and Vasarhelyi, "End-to-End Multi-Level Encoding Methods of Visual Data Compression for Robust Monocular
Visual ORB-SLAM": Table 4 (JPEG), Table 5 (JPEG 2000), Table 6 (one level), all for one 640x480 plane.
Columns: multiplications, additions, bit operations, comparisons, shifts, memory reads, memory writes, total.
"""

from __future__ import annotations

from dataclasses import astuple

import pytest

from codecbench.core.counting.operations import CLASSES, OperationCounts
from codecbench.plugins.evaluators.operations import model

FRAME = model.Plane(640, 480)

TABLES = {
    "4 JPEG encoding": (
        lambda: model.jpeg_encoding(FRAME),
        {
            "dc_shift": (0, 307200, 0, 0, 0, 307200, 307200, 921600),
            "dct": (307200, 537600, 0, 0, 0, 307200, 307200, 1459200),
            "quantization": (307200, 0, 307200, 0, 307200, 307200, 307200, 1536000),
            "huffman_coding": (0, 0, 399360, 337920, 61440, 307200, 61440, 1167360),
        },
        (614400, 844800, 706560, 337920, 368640, 1228800, 983040, 5084160),
    ),
    "4 JPEG decoding": (
        lambda: model.jpeg_decoding(FRAME),
        {
            "huffman_decoding": (0, 0, 92160, 61440, 61440, 61440, 307200, 583680),
            "dequantization": (307200, 0, 307200, 0, 307200, 307200, 307200, 1536000),
            "idct": (307200, 537600, 0, 0, 0, 307200, 307200, 1459200),
            "inverse_dc_shift": (0, 307200, 0, 0, 0, 307200, 307200, 921600),
        },
        (614400, 844800, 399360, 61440, 368640, 983040, 1228800, 4500480),
    ),
    "5 JPEG 2000 encoding": (
        lambda: model.jpeg2000_encoding(FRAME),
        {
            "dc_shift": (0, 307200, 0, 0, 0, 307200, 307200, 921600),
            "dwt": (8184000, 6547200, 0, 0, 3273600, 3273600, 1636800, 22915200),
            "quantization": (307200, 0, 0, 307200, 307200, 307200, 307200, 1536000),
            "tier1_coding": (0, 0, 3932160, 2949120, 0, 1310720, 655360, 8847360),
            "tier2_coding": (614400, 614400, 3072000, 0, 0, 614400, 307200, 5222400),
        },
        (9105600, 7468800, 7004160, 3256320, 3580800, 5813120, 3213760, 39442560),
    ),
    "5 JPEG 2000 decoding": (
        lambda: model.jpeg2000_decoding(FRAME),
        {
            "tier2_decoding": (0, 307200, 1843200, 0, 0, 307200, 307200, 2764800),
            "tier1_decoding": (0, 0, 2621440, 983040, 0, 655360, 327680, 4587520),
            "dequantization": (307200, 0, 0, 0, 307200, 307200, 307200, 1228800),
            "idwt": (6547200, 4910400, 0, 0, 1636800, 1636800, 1636800, 16368000),
            "inverse_dc_shift": (0, 307200, 0, 0, 0, 307200, 307200, 921600),
        },
        (6854400, 5524800, 4464640, 983040, 1944000, 3213760, 2886080, 25870720),
    ),
    "6 one level, encoding": (
        lambda: model.multilevel_encoding(FRAME),
        {
            "dct": (307200, 268800, 307200, 4800, 0, 307200, 307200, 1502400),
            "quantization": (307200, 0, 307200, 0, 0, 307264, 307200, 1228864),
            "minimization": (307200, 204800, 102400, 307200, 0, 307200, 102400, 1331200),
            "arithmetic_coding": (0, 102400, 819200, 102400, 819200, 102400, 102400, 2048000),
        },
        (921600, 576000, 1536000, 414400, 819200, 1024064, 819200, 6110464),
    ),
    "6 one level, decoding": (
        lambda: model.multilevel_decoding(FRAME),
        {
            "arithmetic_decoding": (0, 102400, 819200, 102400, 819200, 102400, 102400, 2048000),
            "sequential_search": (1536000, 1536000, 307200, 1536000, 0, 1536000, 307200, 6758400),
            "dequantization": (307200, 0, 307200, 4800, 0, 307264, 307200, 1233664),
            "idct": (307200, 268800, 38400, 4800, 0, 307200, 307200, 1233600),
        },
        (2150400, 1907200, 1472000, 1648000, 819200, 2252864, 1024000, 11273664),
    ),
}


def row(counts: OperationCounts) -> tuple[int, ...]:
    return (*astuple(counts)[: len(CLASSES)], counts.total)


@pytest.mark.parametrize("table", TABLES)
def test_every_cell_and_total_of_the_paper(table: str) -> None:
    compute, stages, total = TABLES[table]
    computed = compute()
    assert {name: row(counts) for name, counts in computed.items()} == stages
    assert list(computed) == list(stages)
    assert row(OperationCounts.sum(computed.values())) == total


def test_levels_above_the_first_work_on_a_third_each() -> None:
    encoding = model.multilevel_encoding(FRAME, levels=2)
    assert row(encoding["minimization_2"])[:3] == (102400, 102400 - 34134, 34134)
    assert encoding["arithmetic_coding"].adds == 34134
    decoding = model.multilevel_decoding(FRAME, levels=2)
    assert list(decoding)[:3] == ["arithmetic_decoding", "sequential_search_2", "sequential_search"]
    assert decoding["sequential_search_2"].mults == 5 * 102400


def test_a_header_costs_no_arithmetic() -> None:
    decoding = model.multilevel_decoding(FRAME, search=False)
    assert row(decoding["header_lookup"]) == (0, 0, 0, 0, 0, 307200 + 102400, 307200, 716800)


def test_parts_of_blocks_count_as_blocks() -> None:
    assert model.Plane(9, 8).blocks(8) == 2
    assert model.jpeg_encoding(model.Plane(1, 1))["dct"].adds == 112
