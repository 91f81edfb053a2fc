"""What a run says about each codec, sequence by sequence: rate at equal quality, how far tracking holds, time."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd

from codecbench.core.engine.aggregate import percentile
from codecbench.core.results.bjontegaard import BdRate, bd_rate_with_interval
from codecbench.core.results.curves import CurvePoint
from codecbench.core.results.table import CellResult

RATE: Final = "rate_bpp"
QUALITIES: Final = ("psnr_gray_db", "ssim_matlab", "ms_ssim")
"""Frame qualities of the evaluator `quality` for which a BD-rate is given."""

PREFERRED_ANCHOR: Final = "jpeg"


@dataclass(frozen=True)
class Limit:
    """How hard a codec may compress before tracking fails.

    point: the setting of least rate that succeeds, with every setting of more rate succeeding too.
    successes, runs: of that setting. low: 95 % lower confidence bound of its success rate (Wilson).
    next_failing: the setting after it, or nothing where the sweep never failed.
    """

    point: str
    rate_bpp: float
    successes: int
    runs: int
    low: float
    next_failing: str = ""


def frame_matrix(results: list[CellResult], metric: str) -> tuple[list[str], np.ndarray]:
    """Labels and a (settings, frames) array of a per-frame metric, one row a codec setting, NaN where missing."""
    labels, rows = [], []
    for result in results:
        frames = result.frames()
        values = frames[frames["metric"] == metric]
        row = np.full(result.cell.sequence.frames, np.nan)
        row[values["frame"].to_numpy(int)] = values["value"].to_numpy(float)
        labels.append(result.cell.codec.label)
        rows.append(row)
    return labels, np.array(rows)


def bd_rates(
    results: list[CellResult], points: dict[tuple[str, str], CurvePoint], metric: str, *, resamples: int = 200
) -> dict[tuple[str, str], BdRate]:
    """BD-rate of every curve against the anchor, by sequence and curve, with an interval over frames.

    `results` are the ok cells of the evaluator `quality`. The anchor is JPEG where it was run; it is left out.
    """
    grouped: dict[str, dict[str, list[CellResult]]] = defaultdict(lambda: defaultdict(list))
    for result in results:
        codec = result.cell.codec
        grouped[result.cell.sequence.name][points[codec.name, codec.label].curve].append(result)
    found = {}
    for sequence, curves in grouped.items():
        anchor = anchor_of(curves)
        if anchor is None:
            continue
        base = [frame_matrix(curves[anchor], name)[1] for name in (RATE, metric)]
        for curve, members in curves.items():
            if curve != anchor and len(members) > 1:
                test = [frame_matrix(members, name)[1] for name in (RATE, metric)]
                rng = np.random.default_rng(0)
                found[sequence, curve] = bd_rate_with_interval(*base, *test, rng=rng, resamples=resamples)
    return found


def anchor_of(curves: dict[str, list[CellResult]]) -> str | None:
    """The curve that others are compared with: JPEG, or else the first with several settings."""
    several = [curve for curve, members in curves.items() if len(members) > 1]
    return next(
        (curve for curve in several if curve.split(" ")[0] == PREFERRED_ANCHOR), several[0] if several else None
    )


def trajectory_limits(
    wide: pd.DataFrame, tidy_success: pd.DataFrame, points: dict[tuple[str, str], CurvePoint]
) -> dict[tuple[str, str], Limit | None]:
    """The limit of each curve on each sequence, by (sequence, curve); None where not even its best setting succeeds.

    wide: the wide table, for rates. tidy_success: rows of the tidy table for one evaluator's `success`.
    A setting holds where more than half of its runs succeed; a failed run counts as a run without success.
    """
    rates = {
        (row["sequence"], row["codec"], row["setting"]): float(row.get(f"quality.{RATE}.mean", np.nan))
        for row in wide.to_dict("records")
    }
    curves: dict[tuple[str, str], list[tuple[float, str, int, int]]] = defaultdict(list)
    for key, group in tidy_success.groupby(["sequence", "codec", "setting"], sort=False, observed=True):
        sequence, codec, setting = (str(part) for part in key)
        point = points[codec, setting]
        successes = int((group["value"] == 1.0).sum())
        rate = rates.get((sequence, codec, setting), np.nan)
        curves[sequence, point.curve].append((rate, point.point, successes, len(group)))
    return {key: _limit(sorted(members, reverse=True)) for key, members in curves.items()}


def _limit(members: list[tuple[float, str, int, int]]) -> Limit | None:
    """Go down in rate until a setting does not hold."""
    limit = None
    for rate, point, successes, runs in members:
        if 2 * successes <= runs:
            return None if limit is None else Limit(**{**vars(limit), "next_failing": point})
        limit = Limit(point, rate, successes, runs, wilson_low(successes, runs))
    return limit


def wilson_low(successes: int, runs: int) -> float:
    """Lower end of the 95 % Wilson score interval of a proportion (Wilson 1927, doi:10.1080/01621459.1927.10502953)."""
    if runs == 0:
        return float("nan")
    z = 1.959963984540054
    share = successes / runs
    centre = share + z * z / (2 * runs)
    spread = z * np.sqrt(share * (1 - share) / runs + z * z / (4 * runs * runs))
    return float((centre - spread) / (1 + z * z / runs))


def spread(values: np.ndarray) -> str:
    """`12.3 [11.0, 14.2]`: median and quartiles, for people."""
    present = values[~np.isnan(values)]
    if not len(present):
        return "–"
    middle, low, high = (percentile(present, share) for share in (50, 25, 75))
    return f"{middle:.3g}" if low == high else f"{middle:.3g} [{low:.3g}, {high:.3g}]"
