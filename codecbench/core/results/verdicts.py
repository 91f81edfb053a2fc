"""What a run says about each codec, sequence by sequence: rate at equal quality, how far tracking holds, time."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import pandas as pd

from codecbench.core.engine.aggregate import percentile
from codecbench.core.results.bjontegaard import BdRate, bd_rate_with_interval
from codecbench.core.results.curves import CurvePoint
from codecbench.core.results.pareto import pareto_front
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
    rates: list[CellResult],
    qualities: list[CellResult],
    points: dict[tuple[str, str], CurvePoint],
    metric: str,
    *,
    resamples: int = 200,
) -> dict[tuple[str, str], BdRate]:
    """BD-rate of every curve against the anchor, by sequence and curve, with an interval over frames.

    `rates` are the ok cells of the evaluator `quality`, `qualities` those of the evaluator that measures `metric` a
    frame: the same, or `features`. Frames that lack the metric in every setting do not count. The anchor is JPEG where
    it was run; it is left out.
    """
    coded = {_coding(result): result for result in rates}
    pairs = [(coded[_coding(result)], result) for result in qualities if _coding(result) in coded]
    found = {}
    for sequence, curves in _by_curve(pairs, points).items():
        anchor = anchor_of(curves)
        if anchor is None:
            continue
        base = _rates_and_qualities(curves[anchor], metric)
        for curve, members in curves.items():
            if curve != anchor and len(members) > 1:
                test = _rates_and_qualities(members, metric)
                there = ~(np.isnan(base[1]).all(axis=0) | np.isnan(test[1]).all(axis=0))
                four = (array[:, there] for array in (*base, *test))
                rng = np.random.default_rng(0)
                found[sequence, curve] = bd_rate_with_interval(*four, rng=rng, resamples=resamples)
    return found


_Pair = tuple[CellResult, CellResult]


def _coding(result: CellResult) -> tuple[str, str, str]:
    return result.cell.sequence.name, result.cell.codec.name, result.cell.codec.label


def _by_curve(pairs: list[_Pair], points: dict[tuple[str, str], CurvePoint]) -> dict[str, dict[str, list[_Pair]]]:
    """Pairs of cells of one setting, by sequence and curve."""
    grouped: dict[str, dict[str, list[_Pair]]] = defaultdict(lambda: defaultdict(list))
    for pair in pairs:
        cell = pair[0].cell
        grouped[cell.sequence.name][points[cell.codec.name, cell.codec.label].curve].append(pair)
    return grouped


def _rates_and_qualities(members: list[_Pair], metric: str) -> tuple[np.ndarray, np.ndarray]:
    """(settings, frames) each."""
    rates = frame_matrix([rate for rate, _ in members], RATE)[1]
    return rates, frame_matrix([quality for _, quality in members], metric)[1]


def trajectory_bd_rates(
    wide: pd.DataFrame, errors: pd.DataFrame, points: dict[tuple[str, str], CurvePoint], *, resamples: int = 200
) -> dict[tuple[str, str], BdRate]:
    """BD-rate of every curve against the anchor at equal trajectory error, by sequence and curve.

    wide: the wide table, for rates. errors: rows of the tidy table for one evaluator's `ate_rmse_m`. Quality is minus
    the logarithm of the error, so that halving it counts the same everywhere. Errors are noisy: the curves
    are monotone hulls, and the interval is over repeats. A setting with a run without a trajectory is a failure.
    """
    rates = _rates(wide)
    curves: dict[str, dict[str, list[tuple[float, np.ndarray]]]] = defaultdict(lambda: defaultdict(list))
    for key, group in errors.groupby(["sequence", "codec", "setting"], sort=False, observed=True):
        sequence, codec, setting = (str(part) for part in key)
        values = -np.log10(group.sort_values("repeat")["value"].to_numpy(float))
        curves[sequence][points[codec, setting].curve].append((rates[sequence, codec, setting], values))
    found = {}
    for sequence, members in curves.items():
        anchor = anchor_of(members)
        for curve, settings in members.items():
            repeats = {len(values) for name in (anchor, curve) if name for _, values in members[name]}
            if anchor is None or curve == anchor or len(settings) < 2 or len(repeats) != 1:
                continue
            base, test = (_repeated(members[name]) for name in (anchor, curve))
            rng = np.random.default_rng(0)
            found[sequence, curve] = bd_rate_with_interval(*base, *test, rng=rng, hull=True, resamples=resamples)
    return found


def _repeated(settings: list[tuple[float, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """(settings, repeats) each: the rate, the same for all repeats, and the quality."""
    qualities = np.array([values for _, values in settings])
    return np.repeat(np.array([[rate] for rate, _ in settings]), qualities.shape[1], axis=1), qualities


def anchor_of(curves: Mapping[str, Sequence[Any]]) -> str | None:
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
    rates = _rates(wide)
    curves: dict[tuple[str, str], list[tuple[float, str, int, int]]] = defaultdict(list)
    for key, group in tidy_success.groupby(["sequence", "codec", "setting"], sort=False, observed=True):
        sequence, codec, setting = (str(part) for part in key)
        point = points[codec, setting]
        successes = int((group["value"] == 1.0).sum())
        rate = rates.get((sequence, codec, setting), np.nan)
        curves[sequence, point.curve].append((rate, point.point, successes, len(group)))
    return {key: _limit(sorted(members, reverse=True)) for key, members in curves.items()}


def _rates(wide: pd.DataFrame) -> dict[tuple[str, str, str], float]:
    """Mean rate in bpp by sequence, codec and setting; NaN where it was not measured."""
    return {
        (row["sequence"], row["codec"], row["setting"]): float(row.get(f"quality.{RATE}.mean", np.nan))
        for row in wide.to_dict("records")
    }


def _limit(members: list[tuple[float, str, int, int]]) -> Limit | None:
    """Go down in rate until a setting does not hold."""
    limit = None
    for rate, point, successes, runs in members:
        if 2 * successes <= runs:
            return None if limit is None else Limit(**{**vars(limit), "next_failing": point})
        limit = Limit(point, rate, successes, runs, wilson_low(successes, runs))
    return limit


PARETO_CRITERIA: Final[tuple[tuple[str, str, Literal["higher", "lower"]], ...]] = (
    ("rate", "quality.rate_bpp.mean", "lower"),
    ("PSNR", "quality.psnr_gray_db.mean", "higher"),
    ("features kept", "features.keypoint_repeatability.mean", "higher"),
    ("trajectory error", "trajectory.ate_rmse_m.median", "lower"),
    ("encoding time", "timing.encode_cpu_ms.median", "lower"),
    ("decoding time", "timing.decode_cpu_ms.median", "lower"),
    ("operations", "operations.source_total.encode.mean", "lower"),
)
"""What settings are compared in at once: name, column of the wide table, direction."""


def pareto_settings(wide: pd.DataFrame) -> tuple[list[str], np.ndarray]:
    """The criteria that every setting of one sequence has, and which settings no other beats in all of them.

    wide: rows of one sequence. A criterion that some setting lacks (operations of an opaque library, the error of a
    run that failed everywhere) would bar that setting from the front, so it is left out for all.
    """
    usable = [c for c in PARETO_CRITERIA if c[1] in wide.columns and wide[c[1]].notna().all()]
    if not usable:
        return [], np.zeros(len(wide), dtype=bool)
    front = pareto_front(wide[[column for _, column, _ in usable]].to_numpy(float), [way for *_, way in usable])
    return [name for name, *_ in usable], front


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
