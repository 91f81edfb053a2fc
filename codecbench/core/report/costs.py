"""The cost of a setting, in usual units."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
import pandas as pd

from codecbench.core.analysis.limits import POOLED, pooled_rates
from codecbench.core.analysis.passing import Test
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.contracts.errors import PluginError
from codecbench.core.engine.planning.schema import plugin_schema
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.report.tables import padded_digits, three_digits

_FAR: Final = 10.0
"""Factor on the coarsest value tried, up to which coarser settings are proposed."""
_ALIKE: Final = 0.01
"""Frame rates that differ by less than this share are the same."""


def rate_words(run: RunResult, sequence: str, curve: str, test: Test, *, brief: bool = False) -> str:
    """`0.59 Mbit/s at 30 fps (0.27 GB/h)`, or `0.59 Mbit/s` if brief; in the rate's unit if no bit rate is known."""
    unit, number = rate_cell(run, sequence, curve, test)
    mbps = bit_rate_mbps(run, sequence, curve, test)
    if brief or not mbps > 0.0:
        return f"{three_digits(float(number))} {unit}"
    rows, kbps, size = _rows(run, sequence, curve, test), _rate_column(run, "kbit/s"), _rate_column(run, "bytes")
    rates_hz = np.array([]) if size is None else (rows[kbps] * 1e3 / 8.0 / rows[size]).to_numpy(float)
    at = f" at {rates_hz[0]:.3g} fps" if len(rates_hz) and np.ptp(rates_hz) < _ALIKE * rates_hz[0] else ""
    return f"{three_digits(mbps)} {unit}{at} ({three_digits(mbps * 3.6 / 8.0)} GB/h)"


def bit_rate_mbps(run: RunResult, sequence: str, curve: str, test: Test) -> float:
    """The bit rate of a setting; NaN if none is known."""
    kbps = _rate_column(run, "kbit/s")
    return math.nan if kbps is None else float(_rows(run, sequence, curve, test)[kbps].mean()) / 1e3


def rate_of_setting(run: RunResult, sequence: str, codec: str, label: str) -> tuple[float, float]:
    """Kilobits a second and bytes a frame of a setting on a sequence; NaN each if not measured."""
    rows = run.wide[[row == (sequence, codec, label) for row in run.rows]]
    kbps, size = (_rate_column(run, unit) for unit in ("kbit/s", "bytes"))
    means = [math.nan if name is None else float(rows[name].mean()) for name in (kbps, size)]
    return means[0], means[1]


def rate_cell(run: RunResult, sequence: str, curve: str, test: Test) -> tuple[str, str]:
    """The unit and the number of a setting's bit rate, or of its rate if no bit rate is known."""
    mbps = bit_rate_mbps(run, sequence, curve, test)
    if mbps > 0.0 or run.rate is None:
        return "Mbit/s", padded_digits(mbps)
    return run.rate.unit, padded_digits(test.rate * run.rate.factor)


def deciding_cost(run: RunResult, sequence: str, curve: str, test: Test) -> float:
    """The cost that decides between settings that pass: the bit rate, or the rate if no bit rate is known.

    It is milliseconds if times and no task were measured."""
    if times_decide(run):
        return sum(coding_ms(run, sequence, curve, test))
    mbps = bit_rate_mbps(run, sequence, curve, test)
    return mbps if mbps > 0.0 else test.rate


def coding_ms(run: RunResult, sequence: str, curve: str, test: Test) -> tuple[float, float]:
    """Wall milliseconds to encode and to decode a frame; NaN if not measured."""
    rows = _rows(run, sequence, curve, test)
    times = []
    for quantity in ("encoding", "decoding"):
        names = [name for name, column in run.columns.items() if column.metric.quantity == quantity and column.is_usual]
        times.append(float(rows[names[0]].mean()) if names else math.nan)
    return times[0], times[1]


def times_decide(run: RunResult) -> bool:
    """Whether times of encoding and decoding were measured, and neither a task nor a success."""
    measured = {column.metric.quantity for column in run.columns.values()}
    return {"encoding", "decoding"} <= measured and not run.headlines("task", "success")


def coarser_settings(run: RunResult, curve: str) -> str:
    """`h264:crf=38..51`: from the coarsest setting of a curve to the end of its range; empty if there is none."""
    points = [(key, point) for key, point in run.curves.items() if point.curve == curve]
    rates = {label: rate for (_, codec, label), rate in pooled_rates(run).items() if codec == points[0][0][0]}
    ordered = sorted(points, key=lambda item: rates.get(item[0][1], math.nan))
    (codec, label), coarsest = ordered[0]
    name, _, value = coarsest.point.rpartition("=")
    setting = next(
        result.cell.codec
        for result in run.results
        if (result.cell.codec.name, result.cell.codec.label) == (codec, label)
    )
    if setting.distribution or len(points) < 2 or not name:
        return f"coarser {curve}"
    try:
        schema = plugin_schema(installed(), f"codec:{codec}").get("properties", {}).get(name, {})
    except PluginError:
        return f"coarser {curve}"
    rises = coarsest.place > ordered[-1][1].place
    ends = [choice.get("maximum" if rises else "minimum") for choice in (schema, *schema.get("anyOf", ()))]
    end = next((end for end in ends if end is not None), None)
    if end is None:
        return f"coarser {curve}"
    if end == coarsest.place:
        return ""
    far = min(end, _FAR * coarsest.place) if rises else max(end, coarsest.place / _FAR)
    return f"{codec}:{name}={value}..{far:g}" if rises else f"{codec}:{name}={far:g}..{value}"


def _rows(run: RunResult, sequence: str, curve: str, test: Test) -> pd.DataFrame:
    """The rows of the wide table of a setting, on a sequence or on all."""
    run = run.as_calibrated
    names = [key for key, point in run.curves.items() if (point.curve, point.point) == (curve, test.point)]
    return run.wide[[row[1:] in names and sequence in (POOLED, row[0]) for row in run.rows]]


def _rate_column(run: RunResult, unit: str) -> str | None:
    """The name of the rate column with a unit, of the evaluator of the rate; None if there is none."""
    columns = [
        (name, column) for name, column in run.columns.items() if run.rate and column.evaluator == run.rate.evaluator
    ]
    return next((name for name, column in columns if column.metric.role == "rate" and column.metric.unit == unit), None)
