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
"""The error with positions held and its parts, whose squares add up to its square."""
SPREAD: Final = "path_spread_m"
ACCURACY: Final = (
    Metric(
        "held_ate_m", "m", "lower", "RMS position error over all frames, the last known position held where untracked",
        _SPREAD, role="task", headline=True, label="error with positions held", brief="held m", scale="log",
    ),
    Metric(
        "ate_rmse_m", "m", "lower", "RMS position error after Sim(3) alignment, over all tracked frames", _SPREAD,
        headline=True, label="trajectory error", brief="ATE m", scale="log",
    ),
    _part("held_waiting_m", "before the first pose"),
    _part("held_tracked_m", "of tracked frames"),
    _part("held_lost_m", "of frames without a pose"),
    Metric(
        SPREAD, "m", "neither", "RMS distance of the true positions from their mean: held_ate_m of no pose at all",
        _MIDDLE, label="spread of the true path", scale="log",
    ),
    _error("ate_median_m", "median position error after the same alignment", "median trajectory error"),
    _error("ate_rmse_first_frame_m", "RMS position error in first-frame coordinates", "error from the first frame"),
    _error("ate_before_loops_m", "RMS position error before loop closing moved anything", "error before loops"),
    _error("rpe_trans_m", "RMS drift of position over the interval", "drift of position"),
    _error("rpe_rot_deg", "RMS drift of orientation over the interval", "drift of orientation", unit="deg"),
    _error("scale_drift", "change of the map's scale along the way, |ln| of the ratio", "drift of scale", unit="1"),
)  # fmt: skip

LIVE: Final = (
    Metric(
        "live_position_error_m", "m", "lower", "RMS distance of the newest known position from the true one",
        _SPREAD, role="task", headline=True, label="live position error", brief="live m", scale="log", need="error",
    ),
    Metric(
        "idle_error_m", "m", "neither", "the same of the middle of the true path, which a reader may say unseen",
        label="error of a reader that gets nothing", scale="log", need="idle",
    ),
    Metric(
        "fresh_pose_fraction", "1", "higher", "share of the moments at which a pose of the last half second is known",
        label="moments with a fresh pose", need="fresh",
    ),
    Metric("first_pose_s", "s", "lower", "from the first frame until a pose is known", label="time to the first pose"),
    Metric("live_error_max_m", "m", "lower", "the largest such distance", label="worst live error", scale="log"),
    Metric("delivered_fraction", "1", "higher", "share of the frames that SLAM was given", label="delivered share"),
)  # fmt: skip

BEHAVIOUR: Final = (
    Metric(
        "tracked_fraction", "1", "higher", "share of the frames that have a pose in the final map", ("median", "min"),
        headline=True, label="tracked share", brief="tracked",
    ),
    Metric(
        "initialisation_frames", "frames", "lower", "frames that go by before the first map", ("median", "max"),
        label="frames before the first map",
    ),
    Metric(
        "tracked_since_map_fraction", "1", "higher", "share of the frames from the first map on that have a pose",
        ("median", "min"), label="tracked share since the first map",
    ),
    Metric("first_tracked_frame", "frames", "lower", "index of the first frame that has a pose", _MIDDLE),
    Metric("times_lost", "1", "lower", "how often tracking was lost", ("median", "max")),
    Metric("maps", "1", "lower", "maps started and kept", ("median", "max")),
    Metric("maps_merged", "1", "neither", "maps that became part of another one", ("median", "min")),
    Metric("keyframes", "1", "neither", "keyframes in the final map", _MIDDLE),
    Metric("map_points", "1", "neither", "points in the final map", _MIDDLE),
    Metric("loops_closed", "1", "higher", "loops closed", ("median", "min")),
    Metric("loop_frame", "frames", "lower", "index of the frame at which the first loop was closed", _MIDDLE),
    Metric("mean_inliers", "1", "higher", "map points that support a tracked frame's pose", _MIDDLE),
    Metric(
        "slam_ms_per_frame", "ms", "lower", "time that SLAM takes for a frame", _MIDDLE, False,
        role="time", label="SLAM time", scale="log", need="reading",
    ),
    Metric(
        "sent_size_bytes", "bytes", "lower", "bytes that the architecture sends: all frames, or keyframes", _MIDDLE,
        role="rate", label="sent size", scale="log",
    ),
    Metric(
        "sent_rate_kbps", "kbit/s", "lower", "the same per second of the sequence", _MIDDLE,
        role="rate", label="sent rate", scale="log",
    ),
)  # fmt: skip

COMPARED: Final = (
    Metric(
        "success", "1", "higher", "1 where the camera's path holds up beside the raw codec's, else 0", role="success",
        headline=True, label="tracked like raw", brief="success",
    ),
    Metric(
        "starts_in_time", "1", "higher", "1 where the first map comes little later than with the raw codec, else 0",
        role="success", headline=True, label="map starts in time", brief="starts",
    ),
    Metric(
        "raw_path_error_percent", "%", "lower", "distance from raw's paths in percent of their length, without truth",
        _SPREAD, role="task", headline=True, label="distance from raw's path", brief="off raw %", scale="log",
        caveat="there is no ground truth; the paths that SLAM finds on raw pictures stand in for it",
    ),
    Metric(
        "ate_to_raw_m", "m", "lower", "RMS distance from the raw codec's trajectory of the same repeat", _MIDDLE,
        role="task", label="distance from the raw trajectory", scale="log",
    ),
    Metric(
        "ate_minus_raw_m", "m", "lower", "ATE less the raw codec's of the same repeat", _SPREAD,
        role="task", label="error beyond the raw codec's",
    ),
)  # fmt: skip
