"""The metrics of the `trajectory` evaluator. docs/metrics.md defines each."""

from __future__ import annotations

from typing import Final

from codecbench.core.contracts.metric import Metric

_SPREAD = ("median", "iqr", "ci95_low", "ci95_high")
_MIDDLE = ("median",)


def _error(name: str, summary: str, label: str, aggregates: tuple[str, ...] = _MIDDLE, unit: str = "m") -> Metric:
    return Metric(name, unit, "lower", summary, aggregates, role="task", label=label, scale="log")


def _part(name: str, of_what: str) -> Metric:
    return Metric(
        name, "m", "lower", f"part of held_ate_m: {of_what}", _MIDDLE, label=f"held error {of_what}", scale="log"
    )


HELD: Final = ("held_ate_m", "held_waiting_m", "held_tracked_m", "held_lost_m")
"""The ATE with last-pose hold and its parts, whose squares add up to its square."""
SPREAD: Final = "path_spread_m"
ACCURACY: Final = (
    Metric(
        "held_ate_m", "m", "lower",
        "RMS position error of all frames, untracked ones at the last known position",
        _SPREAD, role="task", headline=True, label="error with positions held", column_header="held m", scale="log",
    ),
    Metric(
        "ate_rmse_m", "m", "lower",
        "ATE: RMS position error of tracked frames after Sim(3) alignment", _SPREAD,
        headline=True, label="trajectory error", column_header="ATE m", scale="log",
    ),
    _part("held_waiting_m", "before the first pose"),
    _part("held_tracked_m", "of tracked frames"),
    _part("held_lost_m", "of frames without a pose"),
    Metric(
        SPREAD, "m", "neither", "RMS distance of true positions from their mean",
        _MIDDLE, label="spread of the true path", scale="log",
    ),
    _error("ate_median_m", "median of the errors in ate_rmse_m", "median trajectory error"),
    _error(
        "ate_rmse_first_frame_m",
        "RMS position error relative to the first poses, scaled by the median norm ratio",
        "error from the first frame",
    ),
    _error(
        "ate_before_loops_m", "ate_rmse_m of poses before loop closing, aligned anew",
        "error before loops",
    ),
    _error(
        "rpe_trans_m", "RMS translation error over rpe_interval_s, at the alignment's scale",
        "drift of position",
    ),
    _error("rpe_rot_deg", "RMS rotation error over rpe_interval_s", "drift of orientation", unit="deg"),
    _error(
        "scale_drift",
        "absolute log ratio of scales, last to first third of tracked frames",
        "drift of scale", unit="1",
    ),
)  # fmt: skip

LIVE: Final = (
    Metric(
        "live_position_error_m", "m", "lower",
        "RMS distance between true and newest known position at each capture",
        _SPREAD, role="task", headline=True, label="live position error", column_header="live m", scale="log",
        quantity="error",
    ),
    Metric(
        "idle_error_m", "m", "neither", "live_position_error_m of the constant mean true position",
        label="error without any pose", scale="log", quantity="idle",
    ),
    Metric(
        "fresh_pose_fraction", "1", "higher", "share of captures with a known pose at most 0.5 s old",
        label="captures with a fresh pose", quantity="fresh",
    ),
    Metric(
        "first_pose_s", "s", "lower", "from first capture to first known pose",
        label="time to the first pose",
    ),
    Metric(
        "live_error_max_m", "m", "lower", "largest distance in live_position_error_m",
        label="worst live error", scale="log",
    ),
    Metric(
        "delivered_fraction", "1", "higher", "share of captured frames given to SLAM",
        label="delivered share",
    ),
)  # fmt: skip

BEHAVIOUR: Final = (
    Metric(
        "tracked_fraction", "1", "higher", "share of frames with a final pose",
        ("median", "min"),
        headline=True, label="tracked share", column_header="tracked",
    ),
    Metric(
        "initialisation_frames", "frames", "lower", "frames before the first tracked one, in any map",
        ("median", "max"),
        label="frames before the first map",
    ),
    Metric(
        "tracked_since_map_fraction", "1", "higher", "share of frames from the first tracked one with a final pose",
        ("median", "min"), label="tracked share since the first map",
    ),
    Metric("first_tracked_frame", "frames", "lower", "index of the first frame with a final pose", _MIDDLE),
    Metric("times_lost", "1", "lower", "tracked frames followed by an untracked one", ("median", "max")),
    Metric("maps", "1", "lower", "maps at the end, without merged ones", ("median", "max")),
    Metric("maps_merged", "1", "neither", "maps merged into another", ("median", "min")),
    Metric("keyframes", "1", "neither", "keyframes in the final map", _MIDDLE),
    Metric("map_points", "1", "neither", "points in the final map", _MIDDLE),
    Metric("loops_closed", "1", "higher", "loops closed, without merged maps", ("median", "min")),
    Metric("loop_frame", "frames", "lower", "index of the first loop-closing frame", _MIDDLE),
    Metric("mean_inliers", "1", "higher", "mean map points that support a tracked pose", _MIDDLE),
    Metric(
        "slam_ms_per_frame", "ms", "lower",
        "mean backend time per frame, while other work runs",
        _MIDDLE, False,
        role="time", label="SLAM time", scale="log", quantity="reading",
    ),
    Metric(
        "sent_size_bytes", "bytes", "lower",
        "bytes sent: all frames, keyframes under atc, or all given to the link", _MIDDLE,
        role="rate", label="sent size", scale="log",
    ),
    Metric(
        "sent_rate_kbps", "kbit/s", "lower", "sent_size_bytes per second of the sequence", _MIDDLE,
        role="rate", label="sent rate", scale="log",
    ),
)  # fmt: skip

COMPARED: Final = (
    Metric(
        "success", "1", "higher", "1 if tracked share and error are within their limits, else 0",
        role="success",
        headline=True, label="tracked like raw", column_header="success",
    ),
    Metric(
        "starts_in_time", "1", "higher",
        "1 if the first map comes at most delay_frames after raw's from the same start offset, else 0",
        role="success", headline=True, label="map starts in time", column_header="starts",
    ),
    Metric(
        "raw_path_error_percent", "%", "lower",
        "without ground truth: RMS distance from raw's path over its length, median over other start offsets",
        _SPREAD, role="task", headline=True, label="distance from raw's path", column_header="off raw %", scale="log",
        caveat="there is no ground truth; the paths that SLAM estimates from raw frames replace it",
    ),
    Metric(
        "ate_to_raw_m", "m", "lower", "RMS distance from raw's trajectory of the same repeat", _MIDDLE,
        role="task", label="distance from the raw trajectory", scale="log",
    ),
    Metric(
        "ate_minus_raw_m", "m", "lower", "ate_rmse_m less raw's of the same repeat", _SPREAD,
        role="task", label="error beyond the raw codec's",
    ),
)  # fmt: skip
