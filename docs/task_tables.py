"""Tables of tasks that are asked frame by frame: a known order, and which cheaper metrics follow them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy.stats import spearmanr

from codecbench.core.analysis.evidence import PairedDifference, paired_difference
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.verdicts import frame_matrix
from codecbench.core.report.tables import table

Heads = tuple[str, ...]
KNOWN: Final = ("quality=30", "quality=25")
"""Settings of `jpeg` whose order is known."""
TASKS: Final = (
    "localization.located_auc", "localization.tracked_inliers", "relative_pose.pose_auc_10deg",
    "relative_pose.correct_matches",
)  # fmt: skip
FOLLOWERS: Final = {
    "quality.psnr_gray_db": "PSNR",
    "quality.ssim_matlab": "SSIM",
    "features.keypoint_repeatability": "features kept, the SLAM's ORB",
    "features.matches_kept": "matches kept, the SLAM's ORB",
    "features.opencv_keypoint_repeatability": "features kept, OpenCV's ORB",
    "features.opencv_matches_kept": "matches kept, OpenCV's ORB",
}
"""Metrics that cost less than the tasks, and their labels."""


def known_order(run: RunResult, heads: Heads) -> Iterator[str]:
    """What each headline of role `task` says of two settings of JPEG, frame by frame."""
    rows = []
    for column in run.headlines("task"):
        members = [result for result in run.of(column.evaluator.title) if result.cell.codec.name == "jpeg"]
        labels, values = frame_matrix(members, column.metric.name, column.stage)
        better, worse = (values[labels.index(setting)] for setting in KNOWN)
        found = paired_difference(better, worse)
        kept = (better == better) & (worse == worse)
        means = [f"{series[kept].mean():.4g}" for series in (better, worse)]
        name = f"`{column.evaluator.name}.{column.metric.name}`"
        rows.append([name, *means, shown(found), chance(found.p_value), f"{found.detectable:.2g}",
                     str(found.frames), f"{found.freedom:g}"])  # fmt: skip
    yield table(heads, rows)


def shown(difference: PairedDifference) -> str:
    """A difference with its 95 % interval."""
    low, high = difference.interval
    return f"{difference.mean:+.3g} [{low:+.3g}, {high:+.3g}]"


def chance(p_value: float) -> str:
    """A p-value as tables show it."""
    return "< 0.001" if p_value < 0.001 else f"{p_value:.3f}"


def followers(run: RunResult, heads: Heads) -> Iterator[str]:
    """Spearman correlation of the means of cheaper metrics with those of the tasks, over lossy settings."""
    wide = run.wide
    lossy = wide[np.isfinite(wide["quality.psnr_gray_db.mean"])]
    tasks = [lossy[f"{name}.mean"] for name in TASKS]
    rows = []
    for name, label in FOLLOWERS.items():
        found = [float(spearmanr(lossy[f"{name}.mean"], task, nan_policy="omit").statistic) for task in tasks]
        rows.append([label, *(f"{value:.3f}" for value in found)])
    yield table(heads, rows)
    yield f"{len(lossy)} lossy settings of {lossy['codec'].nunique()} codecs on {run.plan.sequences[0].frames} frames."
