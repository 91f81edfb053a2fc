"""Tables of the SLAM's own options."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.report.tables import table

Heads = tuple[str, ...]


def ablations(run: RunResult, heads: Heads) -> Iterator[str]:
    """What raw frames give with each setting of the backend, one row a sequence and setting."""
    rows = []
    for entry in run.plan.sequences:
        for evaluator in dict.fromkeys(result.cell.evaluator for result in run.results):
            runs = [result for result in run.of(evaluator.title) if result.cell.sequence.name == entry.name]
            options = evaluator.params["backend_params"]
            spelled = " ".join(f"`{name}={value}`" for name, value in options.items()) or "as it comes"
            if runs:
                rows.append([entry.name, spelled, str(len(runs)), *_measured(runs)])
    yield table(heads, rows)


def anchor(run: RunResult, heads: Heads) -> Iterator[str]:
    """What each backend makes of the same frames, one row a sequence, codec and backend."""
    rows = []
    for entry in run.plan.sequences:
        here = [result for result in run.results if result.cell.sequence.name == entry.name]
        for codec in dict.fromkeys(result.cell.codec for result in here):
            for evaluator in dict.fromkeys(result.cell.evaluator for result in here):
                runs = [result for result in here if (result.cell.codec, result.cell.evaluator) == (codec, evaluator)]
                setting = " ".join(filter(None, (codec.name, codec.label)))
                backend = f"`{evaluator.params['backend']}`"
                rows.append([entry.name, setting, backend, str(len(runs)), *_measured(runs)])
    yield table(heads, rows)


def rates(run: RunResult, heads: Heads) -> Iterator[str]:
    """What raw frames give of each sequence of examples/slam_rates.yaml: `place_hz`, or `place_size_hz`."""
    rows = []
    for entry in run.plan.sequences:
        runs = [result for result in run.results if result.cell.sequence.name == entry.name]
        *place, hertz = entry.name.removesuffix("hz").split("_")
        errors_mm = 1e3 * _values(runs, "ate_rmse_m")
        tracked = 100.0 * np.min(_values(runs, "tracked_since_map_fraction"))
        others = (("keyframes", np.median), ("maps", np.max), ("loops_closed", np.min))
        rows.append([
            ", ".join(place), hertz, str(len(runs)), f"{tracked:.1f}", f"{np.nanmedian(errors_mm):.4g}",
            f"{np.nanmax(errors_mm):.4g}", *(f"{of(_values(runs, name)):.0f}" for name, of in others),
        ])  # fmt: skip
    yield table(heads, rows)


def _measured(runs: list[CellResult]) -> list[str]:
    errors_mm = 1e3 * _values(runs, "ate_rmse_m")
    tracked, loops = _values(runs, "tracked_since_map_fraction"), _values(runs, "loops_closed")
    return [
        f"{100 * np.median(tracked):.1f}",
        f"{np.nanmedian(errors_mm):.4g}",
        f"{np.nanmin(errors_mm):.4g} to {np.nanmax(errors_mm):.4g}",
        f"{np.min(loops):.0f}",
    ]


def _values(runs: list[CellResult], metric: str) -> NDArray[np.float64]:
    """The metric of each run; NaN where it is missing."""
    return np.array([
        next((m.value for m in result.measurements if m.metric == metric), np.nan) for result in runs
    ])  # fmt: skip
