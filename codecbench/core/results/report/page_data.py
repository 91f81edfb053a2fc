"""What the report's script draws from: rows, columns, views and operation counts as JSON types."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Final

import pandas as pd

from codecbench.core.contracts.evaluator import Metric
from codecbench.core.results.curves import CurvePoint
from codecbench.core.results.export import json_value
from codecbench.core.results.table import CellResult, shown

PRESETS: Final = (
    ("Rate and PSNR", "quality.rate_bpp.mean", "quality.psnr_gray_db.mean", True, False),
    ("Rate and SSIM", "quality.rate_bpp.mean", "quality.ssim_matlab.mean", True, False),
    ("Rate and trajectory error", "quality.rate_bpp.mean", "trajectory.ate_rmse_m.median", True, True),
    ("Rate and tracked share", "quality.rate_bpp.mean", "trajectory.tracked_fraction.median", True, False),
    ("Rate and features kept", "quality.rate_bpp.mean", "features.keypoint_repeatability.mean", True, False),
    ("Encoding time and PSNR", "timing.encode_wall_ms.median", "quality.psnr_gray_db.mean", True, False),
    ("Decoding time and PSNR", "timing.decode_wall_ms.median", "quality.psnr_gray_db.mean", True, False),
    (
        "Features kept and trajectory error",
        "features.keypoint_repeatability.mean",
        "trajectory.ate_rmse_m.median",
        False,
        True,
    ),
)
"""Views that are offered first where a run has their columns: title, x, y, log x, log y."""

_BRIEF: Final = (
    "quality.rate_bpp.mean", "quality.cr_percent.mean", "quality.psnr_gray_db.mean", "quality.ssim_matlab.mean",
    "features.keypoint_repeatability.mean", "timing.encode_wall_ms.median", "timing.decode_wall_ms.median",
    "trajectory.ate_rmse_m.median", "trajectory.tracked_fraction.median", "trajectory.success.mean",
)  # fmt: skip
_IDENTITY: Final = ("sequence", "codec", "setting", "status", "reason")


def table(wide: pd.DataFrame, points: dict[tuple[str, str], CurvePoint]) -> dict[str, list[Any]]:
    """The wide table by column, as JSON can hold it: infinities as text, missing values as null."""
    found = {str(name): [json_value(value) for value in wide[name].tolist()] for name in wide.columns}
    found["curve"] = [points[key].curve for key in zip(wide["codec"], wide["setting"], strict=True)]
    return found


def columns(wide: pd.DataFrame, results: Iterable[CellResult]) -> dict[str, dict[str, str]]:
    """Unit, direction and meaning of every numeric column; operation counts of single stages are left to their bars."""
    metrics: dict[str, Metric] = {}
    for result in results:
        for name, metric in result.metrics.items():
            metrics[f"{shown(result.cell.evaluator)}.{name}"] = metric
    found = {}
    for column in wide.columns:
        if column in _IDENTITY or "/" in column:
            continue
        stem = _stem(column, metrics)
        if stem:
            known = metrics[stem]
            found[column] = {"unit": known.unit, "better": known.better, "summary": known.summary}
    return found


def presets(known: dict[str, dict[str, str]]) -> list[dict[str, Any]]:
    """The views for which this run has both columns, for every setting of an evaluator."""
    found = []
    for title, x, y, logx, logy in PRESETS:
        for column in matching(known, y):
            label = column.partition("(")[2].partition(")")[0]
            for across in matching(known, x)[:1]:
                name = f"{title} ({label})" if label else title
                found.append({"title": name, "x": across, "y": column, "logx": logx, "logy": logy})
    return found


def brief(known: dict[str, dict[str, str]]) -> list[str]:
    """The columns of the short table."""
    return [column for wanted in _BRIEF for column in matching(known, wanted)]


def matching(known: Iterable[str], wanted: str) -> list[str]:
    """Columns that are `wanted`, whatever the label of the evaluator's setting."""
    evaluator, _, rest = wanted.partition(".")
    return [
        name for name in known if name == wanted or (name.startswith(f"{evaluator}(") and name.endswith(f").{rest}"))
    ]


def intervals(wide: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Columns of medians that have a confidence interval beside them."""
    names = set(wide.columns)
    found = {}
    for name in names:
        stem = name.rpartition(".")[0]
        low, high = f"{stem}.ci95_low", f"{stem}.ci95_high"
        if name.endswith(".median") and low in names and high in names:
            found[name] = (low, high)
    return found


def operations(wide: pd.DataFrame) -> list[dict[str, Any]]:
    """Total operations of each stage, for the bars: columns `operations.FAMILY_total.DIRECTION/STAGE.mean`."""
    bars = []
    for column in wide.columns:
        parts = column.split(".")
        if (
            len(parts) != 4
            or not parts[0].startswith("operations")
            or not parts[1].endswith("_total")
            or "/" not in parts[2]
        ):
            continue
        direction, _, stage = parts[2].partition("/")
        for record in wide[["sequence", "codec", "setting", column]].to_dict("records"):
            value = record[column]
            if isinstance(value, float) and math.isnan(value):
                continue
            bars.append(
                {
                    "family": parts[1].removesuffix("_total"),
                    "direction": direction,
                    "stage": stage,
                    "sequence": record["sequence"],
                    "bar": f"{record['codec']} {record['setting']}".strip(),
                    "value": float(value),
                }
            )
    return bars


def _stem(column: str, metrics: dict[str, Metric]) -> str:
    """The evaluator and metric of a column, without stage and aggregate; nothing where no metric is known."""
    stem = column
    while stem and stem not in metrics:
        stem = stem.rpartition(".")[0]
    return stem
