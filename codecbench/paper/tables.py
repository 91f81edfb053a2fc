"""The paper's Tables 1-6, each beside ours."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pandas as pd

from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.report.tables import change, foreign_table
from codecbench.paper import facts
from codecbench.paper.measured import Measured

_PSNR = "quality.psnr_gray_db.mean"
_SSIM = "quality.ssim_matlab.mean"
_CR = "quality.cr_percent.mean"
_CLASSES = ("mults", "adds", "bit_ops", "comparisons", "shifts", "reads", "writes")


def quality_tables(measured: Measured) -> Iterator[str]:
    """Tables 1, 2 and 3: size, quality, compression ratio and time, at the paper's settings, on every sequence."""
    yield "## Table 1: JPEG with a quantization factor\n"
    yield _sized(measured, "jpeg_qf", "qf", facts.table("table1_jpeg"), {})
    yield "## Table 2: JPEG 2000\n"
    yield _sized(measured, "jpeg2000", "cr_percent", facts.table("table2_jpeg2000"), {})
    paper = facts.table("table3_multilevel")
    for levels in (1, 2):
        renamed = paper.rename(
            columns={f"l{levels}_{name}": name for name in ("size_kb", "cr_percent", "encode_s", "decode_s")}
        )
        yield f"## Table 3: multi-level, {'one level' if levels == 1 else 'two levels'}\n"
        yield _sized(measured, "multilevel", "qf", renamed, {"levels": levels})


def _sized(measured: Measured, codec: str, key: str, paper: pd.DataFrame, fixed: dict[str, Any]) -> str:
    heads = [
        key, "", "size [KiB]", "against the paper", "PSNR [dB]", "SSIM", "CR [%]", "encode [ms]", "decode [ms]",
    ]  # fmt: skip
    rows: list[list[Any]] = []
    for value, group in paper.groupby(key, sort=True):
        mean_kib = float(group["size_kb"].mean())
        setting = measured.setting(codec, **{key: value}, **fixed)
        rows += [[value, *_stated(row)] for row in group.to_dict("records")]
        rows += [[value, f"ours, {name}", *_ours(measured, name, setting, mean_kib)] for name in measured.sequences]
    return foreign_table(heads, rows)


def _stated(row: dict[Any, Any]) -> list[Any]:
    quality = [row["psnr_db"], row["ssim"], row.get("cr_percent")]
    return [
        f"paper, frame {row['frame']}",
        row["size_kb"],
        "",
        *quality,
        1000 * row["encode_s"],
        1000 * row["decode_s"],
    ]


def _ours(measured: Measured, sequence: str, setting: PluginSetting | None, paper_kib: float) -> list[Any]:
    size = measured.size_kib(sequence, setting)
    values = [measured.value(sequence, setting, column) for column in (_PSNR, _SSIM, _CR)]
    times = [measured.value(sequence, setting, f"timing.{way}_wall_ms.median") for way in ("encode", "decode")]
    return [size, change(size, paper_kib), *values, *times]


def operation_tables(measured: Measured) -> Iterator[str]:
    """Tables 4, 5 and 6: the paper's counts, the same from its formulas, and what our kernels really did."""
    paper = facts.table("table456_operations")
    settings = {
        4: measured.setting("jpeg_qf", qf=5),
        5: measured.setting("jpeg2000", cr_percent=73),
        6: measured.setting("multilevel", qf=5, levels=1, decoding="search")
        or measured.setting("multilevel", qf=5, levels=1),
    }
    for number, setting in settings.items():
        stated = paper[paper["table"] == number]
        yield f"## Table {number}: operations of {stated['codec'].iloc[0]}\n"
        rows = [
            [f"paper, {row['direction']} {row['stage']}", *(row[name] for name in _CLASSES), row["total"]]
            for row in stated.to_dict("records")
        ]
        rows += _counted(measured, setting)
        yield foreign_table(["stage", *(name.replace("_", " ") for name in _CLASSES), "total"], rows)


def _counted(measured: Measured, setting: PluginSetting | None) -> list[list[Any]]:
    """Our totals by family and direction on each sequence; opaque codecs have no source counts."""
    rows: list[list[Any]] = []
    for sequence in measured.sequences:
        for family in ("model", "source", "machine"):
            for direction in ("encode", "decode"):
                columns = [f"operations.{family}_{name}.{direction}.mean" for name in (*_CLASSES, "total")]
                values = [measured.value(sequence, setting, column) for column in columns]
                if any(value == value for value in values):
                    rows.append([f"ours, {family}, {direction}, {sequence}", *values])
    return rows
