"""Draw a trajectory cell from its files: paths in the plane in which the true one spreads most, and a timeline."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.evaluator import Outcome
from codecbench.core.contracts.view import Drawing, FrameTimeline, Line, TimelineRow, Tone
from codecbench.plugins.evaluators.outcomes import rows_of_outcomes
from codecbench.plugins.evaluators.trajectory import files
from codecbench.plugins.evaluators.trajectory.alignment import nearest_stamps

NOTE: Final = (
    "The drawing plane is the one in which the true path spreads most. A similarity aligns the estimate with ground "
    "truth. Estimated: as tracked; optimised: after loop closing. Over a link, the error of a frame is that of the "
    "newest pose at its capture."
)
_STATES: Final[dict[str, tuple[str, Tone]]] = {
    "tracked": ("tracked", "good"),
    "not_initialized": ("no map yet", "fair"),
    "refused": ("refused", "fair"),
    "lost": ("track lost", "bad"),
}
"""By SLAM state of a frame, its name and tone on a timeline."""
_SAME_S: Final = 1e-6
"""Stamps are equal within the rounding of files, which have microseconds."""
_MARGIN_S: Final = 0.5
"""Ground truth is drawn this far beyond the first and last frame that SLAM got."""


def draw(outcome: Outcome) -> Drawing | None:
    """Ground truth, the path as tracked and the corrected path, in metres; None if there is neither path nor truth."""
    folder = outcome.artifacts
    optimised, estimated = (_positions(folder / name) for name in (files.TRAJECTORY, files.TRAJECTORY_BEFORE_LOOPS))
    truth = _positions(folder / files.GROUND_TRUTH)
    if not len(optimised) and not len(truth):
        return None
    span_s = _span_s(folder / files.STATES)
    if span_s is not None:
        truth = truth[(truth[:, 0] >= span_s[0] - _MARGIN_S) & (truth[:, 0] <= span_s[1] + _MARGIN_S)]
    centre, axes = _plane(truth if len(truth) else optimised)
    paths = (
        Line("ground truth", "truth", (truth[:, 1:] - centre) @ axes.T),
        Line("estimated", "before", (estimated[:, 1:] - centre) @ axes.T),
        Line("optimised", "after", (optimised[:, 1:] - centre) @ axes.T),
    )
    success = outcome.value("success")
    is_success = None if math.isnan(success) else success == 1.0
    timeline = _timeline(folder, optimised, truth, centre, axes)
    return Drawing(tuple(path for path in paths if len(path.points)), _caption(outcome), is_success, timeline=timeline)


def _timeline(
    folder: Path,
    optimised: NDArray[np.float64],
    truth: NDArray[np.float64],
    centre: NDArray[np.float64],
    axes: NDArray[np.float64],
) -> FrameTimeline | None:
    """The final position of each frame that SLAM got, and its distance from the true path.

    Over a link, the newest known position at the capture of every frame.
    """
    if not (folder / files.STATES).exists():
        return None
    with (folder / files.STATES).open(newline="") as stream:
        records = [(int(row["frame"]), float(row["timestamp_s"]), row["state"]) for row in csv.DictReader(stream)]
    indices, stamps_s = np.array([row[0] for row in records], np.int64), np.array([row[1] for row in records])
    states = {frame: state for frame, _, state in records}
    if (folder / files.LIVE).exists():
        live = files.read_live(folder / files.LIVE)
        if records:
            stamps_s = live.taken_s + (stamps_s[0] - live.taken_s[live.frames == indices[0]][0])
        else:
            stamps_s = live.taken_s
        errors_m = _distances(live.positions, stamps_s, truth)
        rows = (*rows_of_outcomes(live.outcomes), *_tracking_rows(live.frames, states))
        return FrameTimeline(
            live.frames, (live.positions - centre) @ axes.T, errors_m, "m", rows, "live position error"
        )
    at = nearest_stamps(stamps_s, optimised[:, 0], _SAME_S)
    places = np.full((len(records), 3), np.nan)
    places[at >= 0] = optimised[at[at >= 0], 1:]
    errors_m = _distances(places, stamps_s, truth)
    return FrameTimeline(indices, (places - centre) @ axes.T, errors_m, "m", _tracking_rows(indices, states))


def _tracking_rows(frames: NDArray[np.int64], states: dict[int, str]) -> tuple[TimelineRow, ...]:
    """One timeline row for each SLAM state that occurs. states: by frame."""
    values = np.array([states.get(frame, "") for frame in frames.tolist()], dtype=object)
    return tuple(
        TimelineRow(name, tone, values == state) for state, (name, tone) in _STATES.items() if (values == state).any()
    )


def _distances(
    places: NDArray[np.float64], stamps_s: NDArray[np.float64], truth: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(N,) distance of each place (N, 3) from the true path at its time, linear between poses; NaN outside the path."""
    if len(truth) < 2:
        return np.full(len(places), np.nan)
    columns = [np.interp(stamps_s, truth[:, 0], truth[:, axis], left=np.nan, right=np.nan) for axis in (1, 2, 3)]
    distances: NDArray[np.float64] = np.linalg.norm(places - np.column_stack(columns), axis=1)
    return distances


def _caption(outcome: Outcome) -> str:
    """Error and tracked share together, because the error alone would favor a tracker that gets lost."""
    error_m, tracked = outcome.value("ate_rmse_m"), outcome.value("tracked_fraction")
    words = ["error unknown" if math.isnan(error_m) else f"ATE {error_m:.3g} m", f"{100 * tracked:.0f} % tracked"]
    loops = outcome.value("loops_closed")
    if loops > 0:
        words.append(f"{loops:.0f} loop{'s' if loops > 1 else ''}")
    if outcome.value("success") == 0.0:
        words.append("fails")
    return ", ".join(words)


def _positions(path: Path) -> NDArray[np.float64]:
    """(N, 4) rows of timestamp, x, y, z from a file in TUM's format; empty if there is no file."""
    lines = path.read_text().splitlines() if path.exists() else []
    rows = [line.split()[:4] for line in lines if line and not line.startswith("#")]
    return np.array(rows, dtype=np.float64).reshape(-1, 4)


def _span_s(states: Path) -> tuple[float, float] | None:
    """Times of the first and the last frame that SLAM got; None if there is none."""
    if not states.exists():
        return None
    with states.open(newline="") as stream:
        stamps_s = [float(row["timestamp_s"]) for row in csv.DictReader(stream)]
    return (min(stamps_s), max(stamps_s)) if stamps_s else None


def _plane(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre (3,) and axes (2, 3) of the plane in which positions spread most."""
    if len(rows) < 3:
        return np.zeros(3), np.eye(3)[:2]
    centre = rows[:, 1:].mean(axis=0)
    _, _, axes = np.linalg.svd(rows[:, 1:] - centre, full_matrices=False)
    signs = np.where(axes[np.arange(2), np.abs(axes[:2]).argmax(axis=1)] < 0, -1.0, 1.0)
    return centre, axes[:2] * signs[:, None]
