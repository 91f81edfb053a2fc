"""Figures for print: rate curves, operation counts, trajectories over ground truth, and maps."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from codecbench.core.engine.planning.model import SequenceEntry
from codecbench.core.results.report import page_data
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.trajectories import SavedTrajectory, saved_trajectories

COLOURS: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6BB1", "#777777")
MARKERS: Final = ("o", "s", "D", "^", "P", "X", "*", "h")
_STYLE: Final[Any] = {
    "font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False, "axes.spines.right": False,
    "figure.constrained_layout.use": True, "svg.hashsalt": "codecbench", "legend.frameon": False,
}  # fmt: skip
_CURVES: Final = (
    ("rate_psnr", "quality.rate_bpp.mean", "quality.psnr_gray_db.mean", "rate [bit/pixel]", "PSNR gray [dB]", False),
    ("rate_ssim", "quality.rate_bpp.mean", "quality.ssim_matlab.mean", "rate [bit/pixel]", "SSIM", False),
    ("rate_features", "quality.rate_bpp.mean", "features.keypoint_repeatability.mean", "rate [bit/pixel]",
     "share of ORB keypoints found again", False),
    ("rate_ate", "quality.rate_bpp.mean", "trajectory.ate_rmse_m.median", "rate [bit/pixel]", "ATE RMSE [m]", True),
)  # fmt: skip


def draw_all(run: RunResult, folder: Path, format_: str = "svg") -> Iterator[Path]:
    """Draw every figure for which the run has data into `folder`, and give the path of each."""
    folder.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(_STYLE):
        for name, figure in _figures(run):
            path = folder / f"{name}.{format_}"
            figure.savefig(path, dpi=160, metadata={"Date": None} if format_ == "svg" else None)
            plt.close(figure)
            yield path


def _figures(run: RunResult) -> Iterator[tuple[str, Figure]]:
    for entry in run.plan.sequences:
        for name, x, y, across, up, log in _CURVES:
            for column in page_data.matching([str(name) for name in run.wide.columns], y):
                figure = curve_figure(run, entry, x, column, across, up, log)
                if figure is not None:
                    yield f"{_file_name(entry.name)}-{name}{_suffix(column)}", figure
    yield from trajectory_figures(run)
    operations = operations_figure(run)
    if operations is not None:
        yield "operations", operations


def curve_figure(
    run: RunResult, entry: SequenceEntry, x: str, y: str, across: str, up: str, log: bool
) -> Figure | None:
    """One line a curve of settings, rates on a logarithmic axis; None where no setting has both values.

    Bars are the 95 % intervals of medians over repeats, where there are any.
    """
    rows = run.wide[run.wide["sequence"] == entry.name]
    if x not in rows or y not in rows:
        return None
    ends = page_data.intervals(run.wide).get(y, ())
    lines: dict[str, list[tuple[float, float, float, float]]] = {}
    for row in rows.to_dict("records"):
        value = float(row[y])
        low, high = (float(row[end]) for end in ends) if ends else (math.nan, math.nan)
        point = (float(row[x]), value, value - low, high - value)
        if all(map(math.isfinite, point[:2])):
            lines.setdefault(run.curves[row["codec"], row["setting"]].curve, []).append(point)
    if not lines:
        return None
    figure, axes = plt.subplots(figsize=(5.2, 4.0))
    for index, (curve, points) in enumerate(lines.items()):
        points.sort()
        style: dict[str, Any] = {
            "color": COLOURS[index % len(COLOURS)],
            "marker": MARKERS[index % len(MARKERS)],
            "markersize": 4,
        }
        rates, values, below, above = zip(*points, strict=True)
        axes.errorbar(rates, values, (below, above), label=curve, linewidth=1.2, elinewidth=0.6, capsize=2, **style)
    axes.set_xscale("log")
    if log:
        axes.set_yscale("log")
    axes.set(xlabel=across, ylabel=up, title=entry.name)
    axes.xaxis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
    figure.legend(loc="outside lower center", ncols=2, fontsize=7)
    return figure


def trajectory_figures(run: RunResult) -> Iterator[tuple[str, Figure]]:
    """The paper's Figures 7 to 11: for each sequence and codec, small multiples over its settings, first repeat."""
    groups: dict[tuple[str, str, str], list[SavedTrajectory]] = {}
    for one in saved_trajectories(run):
        if one.repeat == 0:
            groups.setdefault((one.sequence, one.codec, one.evaluator_label), []).append(one)
    for (sequence, codec, label), members in groups.items():
        name = "-".join(filter(None, (_file_name(sequence), "trajectory", codec, _file_name(label))))
        yield name, _multiples(f"{sequence}: {codec} {label}".strip(), members)


def _multiples(title: str, members: list[SavedTrajectory]) -> Figure:
    across = min(4, len(members))
    down = math.ceil(len(members) / across)
    figure, grid = plt.subplots(down, across, figsize=(max(3.6, 2.6 * across), 2.7 * down + 0.5), squeeze=False)
    for axes in grid.flat[len(members) :]:
        axes.set_visible(False)
    for axes, one in zip(grid.flat, members, strict=False):
        _draw(axes, one)
    handles, labels = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3, fontsize=8)
    figure.suptitle(title, fontsize=10)
    return figure


def _draw(axes: Any, one: SavedTrajectory) -> None:
    for points, label, style in (
        (one.truth, "ground truth", {"color": "#8a8f98", "linewidth": 2.6, "alpha": 0.7}),
        (one.estimated, "estimated", {"color": "#E69F00", "linewidth": 1.0, "linestyle": "--"}),
        (one.optimised, "optimised", {"color": "#0072B2", "linewidth": 1.1}),
    ):
        if points is not None and len(points):
            axes.plot(points[:, 0], points[:, 1], label=label, **style)
    axes.set_aspect("equal", adjustable="datalim")
    colour = "#a02020" if one.success is False else "black"
    axes.set_title(f"{one.setting or one.codec}\n{one.caption}", fontsize=7, color=colour)
    axes.tick_params(labelsize=6)


def operations_figure(run: RunResult) -> Figure | None:
    """The paper's Figure 12: operations a frame, encoding and decoding, by family, the first sequence."""
    bars = page_data.operations(run.wide)
    if not bars:
        return None
    sequence = run.plan.sequences[0].name
    totals: dict[tuple[str, str], dict[str, float]] = {}
    for bar in bars:
        if bar["sequence"] == sequence:
            found = totals.setdefault((bar["family"], bar["direction"]), {})
            found[bar["bar"]] = found.get(bar["bar"], 0.0) + bar["value"]
    height = 0.17 * max(map(len, totals.values())) + 1.2
    figure, grid = plt.subplots(1, len(totals), figsize=(3.4 * len(totals), height), squeeze=False)
    for axes, ((family, direction), values) in zip(grid.flat, sorted(totals.items()), strict=True):
        names = list(values)
        axes.barh(names, np.array([values[name] for name in names]) / 1e6, color=COLOURS[0])
        axes.invert_yaxis()
        axes.tick_params(labelsize=6)
        axes.set(title=f"{family}, {direction}", xlabel="million operations a frame")
    return figure


def _suffix(column: str) -> str:
    label = column.partition("(")[2].partition(")")[0]
    return f"-{_file_name(label)}" if label else ""


def _file_name(text: str) -> str:
    return "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in text)
