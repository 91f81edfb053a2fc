"""The metrics of the `trajectory` evaluator. docs/metrics.md defines each."""

from __future__ import annotations

from typing import Final

from codecbench.core.contracts.evaluator import Metric

_SPREAD = ("median", "iqr", "ci95_low", "ci95_high")
_MIDDLE = ("median",)

ACCURACY: Final = (
    Metric("ate_rmse_m", "m", "lower", "RMS position error after Sim(3) alignment, over all tracked frames", _SPREAD),
    Metric("ate_median_m", "m", "lower", "median position error after the same alignment", _MIDDLE),
    Metric("ate_rmse_first_frame_m", "m", "lower", "RMS position error in first-frame coordinates", _MIDDLE),
    Metric("ate_before_loops_m", "m", "lower", "RMS position error before loop closing moved anything", _MIDDLE),
    Metric("coverage_penalised_ate_m", "m", "lower", "RMS position error with untracked frames charged", _SPREAD),
    Metric("rpe_trans_m", "m", "lower", "RMS drift of position over the interval", _MIDDLE),
    Metric("rpe_rot_deg", "deg", "lower", "RMS drift of orientation over the interval", _MIDDLE),
    Metric("scale_drift", "1", "lower", "change of the map's scale along the way, |ln| of the ratio", _MIDDLE),
)

BEHAVIOUR: Final = (
    Metric(
        "tracked_fraction", "1", "higher", "share of the frames that have a pose in the final map", ("median", "min")
    ),
    Metric("first_tracked_frame", "frames", "lower", "index of the first frame that has a pose", _MIDDLE),
    Metric("times_lost", "1", "lower", "how often tracking was lost", ("median", "max")),
    Metric("maps", "1", "lower", "maps started and kept", ("median", "max")),
    Metric("keyframes", "1", "neither", "keyframes in the final map", _MIDDLE),
    Metric("map_points", "1", "neither", "points in the final map", _MIDDLE),
    Metric("loops_closed", "1", "higher", "loops closed", ("median", "min")),
    Metric("loop_frame", "frames", "lower", "index of the frame at which the first loop was closed", _MIDDLE),
    Metric("mean_inliers", "1", "higher", "map points that support a tracked frame's pose", _MIDDLE),
    Metric("slam_ms_per_frame", "ms", "lower", "time that SLAM takes for a frame", _MIDDLE, repeatable=False),
    Metric("sent_size_bytes", "bytes", "lower", "bytes that the architecture sends: all frames, or keyframes", _MIDDLE),
    Metric("sent_rate_kbps", "kbit/s", "lower", "the same per second of the sequence", _MIDDLE),
)

COMPARED: Final = (
    Metric("success", "1", "higher", "1 where the camera's path holds up, else 0; the mean is the success rate"),
    Metric("ate_to_raw_m", "m", "lower", "RMS distance from the raw codec's trajectory of the same repeat", _MIDDLE),
    Metric("ate_minus_raw_m", "m", "lower", "ATE less the raw codec's of the same repeat", _SPREAD),
)
