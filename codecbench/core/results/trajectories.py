"""Trajectories that cells of a run left, seen from where the true path spreads most."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.results.run_result import RunResult
from codecbench.core.results.table import CellResult

Path2 = NDArray[np.float64]
"""(N, 2) positions in the plane of the picture, metres."""

_OPTIMISED: Final = "trajectory.txt"
_ESTIMATED: Final = "trajectory_before_loops.txt"
_TRUTH: Final = "ground_truth.txt"
_MARGIN_S: Final = 0.5
"""Ground truth is drawn this much beyond the first and last tracked frame's sequence."""


@dataclass(frozen=True)
class SavedTrajectory:
    """One repeat of one setting: ground truth, as tracked ("estimated"), and after all corrections ("optimised")."""

    sequence: str
    codec: str
    setting: str
    evaluator_label: str
    repeat: int
    truth: Path2 | None
    estimated: Path2 | None
    optimised: Path2 | None
    caption: str
    success: bool | None


def saved_trajectories(run: RunResult) -> Iterator[SavedTrajectory]:
    """Every trajectory of the run, in the order of the plan; cells that tracked nothing are passed over."""
    spans = {entry.name: _span(run, entry.name) for entry in run.plan.sequences}
    for result in run.results:
        if result.status == "ok" and (result.folder / _OPTIMISED).exists():
            saved = _saved(result, spans[result.cell.sequence.name])
            if saved.optimised is not None and len(saved.optimised):
                yield saved


def _saved(result: CellResult, span_s: tuple[float, float] | None) -> SavedTrajectory:
    truth = _positions(result.folder / _TRUTH)
    optimised, estimated = (_positions(result.folder / name) for name in (_OPTIMISED, _ESTIMATED))
    if truth is not None and span_s is not None:
        kept = (truth[:, 0] >= span_s[0] - _MARGIN_S) & (truth[:, 0] <= span_s[1] + _MARGIN_S)
        truth = truth[kept]
    plane = _plane(truth if truth is not None and len(truth) else optimised)
    value = {one.metric: one.value for one in result.measurements}
    success = value.get("success", math.nan)
    return SavedTrajectory(
        sequence=result.cell.sequence.name,
        codec=result.cell.codec.name,
        setting=result.cell.codec.label,
        evaluator_label=result.cell.evaluator.label,
        repeat=result.cell.repeat,
        truth=_projected(truth, plane),
        estimated=_projected(estimated, plane),
        optimised=_projected(optimised, plane),
        caption=_caption(value),
        success=None if math.isnan(success) else success == 1.0,
    )


def _caption(value: dict[str, float]) -> str:
    """Error and coverage together: an error alone would flatter a tracker that got lost."""
    error, tracked = value.get("ate_rmse_m", math.nan), value.get("tracked_fraction", math.nan)
    words = ["no error known" if math.isnan(error) else f"ATE {error:.3g} m", f"{100 * tracked:.0f} % tracked"]
    loops = value.get("loops_closed", 0.0)
    if loops:
        words.append(f"{loops:.0f} loop{'s' if loops > 1 else ''}")
    if value.get("success") == 0.0:
        words.append("fails")
    return ", ".join(words)


def _positions(path: Path) -> NDArray[np.float64] | None:
    """Rows timestamp, x, y, z of a file in TUM's format, or None where there is none."""
    if not path.exists():
        return None
    lines = [line.split()[:4] for line in path.read_text().splitlines() if line and not line.startswith("#")]
    return np.array(lines, dtype=np.float64).reshape(-1, 4)


def _span(run: RunResult, sequence: str) -> tuple[float, float] | None:
    """First and last timestamp that any setting tracked on a sequence."""
    stamps = []
    for result in run.results:
        if result.cell.sequence.name == sequence and (result.folder / _OPTIMISED).exists():
            rows = _positions(result.folder / _OPTIMISED)
            if rows is not None and len(rows):
                stamps += [rows[0, 0], rows[-1, 0]]
    return (min(stamps), max(stamps)) if stamps else None


def _plane(rows: NDArray[np.float64] | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Centre (3,) and axes (2, 3) of the plane in which positions spread most."""
    if rows is None or len(rows) < 3:
        return np.zeros(3), np.eye(3)[:2]
    centre = rows[:, 1:].mean(axis=0)
    _, _, axes = np.linalg.svd(rows[:, 1:] - centre, full_matrices=False)
    signs = np.where(axes[np.arange(2), np.abs(axes[:2]).argmax(axis=1)] < 0, -1.0, 1.0)
    return centre, axes[:2] * signs[:, None]


def _projected(
    rows: NDArray[np.float64] | None, plane: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> Path2 | None:
    return None if rows is None else (rows[:, 1:] - plane[0]) @ plane[1].T
