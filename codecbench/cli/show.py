"""Tables in the terminal."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import pandas as pd
from rich.console import Console
from rich.table import Table

if TYPE_CHECKING:
    from codecbench.core.results.run_result import RunResult

_BRIEF: Final = {
    "quality.rate_bpp.mean": "bpp",
    "quality.cr_percent.mean": "CR %",
    "quality.psnr_gray_db.mean": "PSNR dB",
    "quality.ssim_matlab.mean": "SSIM",
    "features.keypoint_repeatability.mean": "features",
    "timing.encode_wall_ms.median": "enc ms",
    "timing.decode_wall_ms.median": "dec ms",
    "operations.source_total.encode.mean": "enc Mops",
    "operations.model_total.encode.mean": "model Mops",
    "trajectory.ate_rmse_m.median": "ATE m",
    "trajectory.tracked_fraction.median": "tracked",
    "trajectory.success.mean": "success",
}
_MEGA: Final = ("enc Mops", "model Mops")
_MOST_ROWS: Final = 400


def show_summary(result: RunResult) -> None:
    """The columns of the wide table that most people ask for first."""
    wide = result.wide
    names = {name: short for name, short in _BRIEF.items() if name in wide.columns and wide[name].notna().any()}
    shown = wide[["sequence", "codec", "setting", *names, "status"]].rename(columns=names)
    for name in _MEGA:
        if name in shown.columns:
            shown[name] = shown[name] / 1e6
    show_table(shown, result)


def show_table(frame: pd.DataFrame, result: RunResult) -> None:
    """A table in the terminal; long ones end with how many rows were left out."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=160)
    table = Table(title=result.plan.name, title_justify="left", header_style="bold", row_styles=["", "dim"])
    for name in frame.columns:
        number = pd.api.types.is_numeric_dtype(frame[name])
        table.add_column(str(name), justify="right" if number else "left", no_wrap=number, overflow="fold")
    for row in frame.head(_MOST_ROWS).itertuples(index=False):
        table.add_row(*(_cell(value) for value in row))
    console.print(table)
    if len(frame) > _MOST_ROWS:
        console.print(f"... and {len(frame) - _MOST_ROWS} more rows; use --format csv for all of them")


def _cell(value: object) -> str:
    if value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, float):
        return "∞" if math.isinf(value) else f"{value:.4g}"
    return str(value)
