"""What two records of the same cell have in common: to the bit, within a tolerance, or not."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any, Final, Literal

from codecbench.core.engine.planning.model import Cell
from codecbench.core.engine.storage.record import Record
from codecbench.core.engine.storage.samples import table_from_parquet
from codecbench.core.engine.storage.store import Store

Verdict = Literal["to the bit", "within tolerance", "differs", "not recomputed"]
VERDICTS: Final[tuple[Verdict, ...]] = ("to the bit", "within tolerance", "differs", "not recomputed")

TOLERANCE: Final = 1e-6
"""Relative difference of two values up to which they agree where libraries have other versions: more than sums of
floats in another order make, less than any table shows."""

_WITHOUT_NUMBERS: Final = {"distributed", "pandas", "pebble", "pyarrow", "pydantic"}
"""Distributions that carry results and compute none."""

Values = dict[tuple[str, str, int | None, int], float]
"""Values by metric, stage, frame, and how many of the same came before."""


@dataclass(frozen=True)
class Agreement:
    """What became of a cell. values: how many were compared. note: which differs first, or why there are none."""

    cell: Cell
    verdict: Verdict
    values: int = 0
    note: str = ""


def values_of(store: Store, record: Record, metrics: Collection[str] | None) -> Values:
    """What a record measured of these metrics, all where it is None. Raises StoreError, ValueError or OSError."""
    rows = [(each.metric, each.stage or "", None, each.value) for each in record.measurements]
    content = store.samples(record)
    if content is not None:
        columns = table_from_parquet(content).to_pydict()
        names = ("metric", "stage", "frame", "value")
        found = zip(*(columns[name] for name in names), strict=True)
        rows += [
            (metric, stage or "", frame, math.nan if value is None else value) for metric, stage, frame, value in found
        ]
    values: Values = {}
    for metric, stage, frame, value in rows:
        if metrics is not None and metric not in metrics:
            continue
        place = 0
        while (metric, stage, frame, place) in values:
            place += 1
        values[metric, stage, frame, place] = value
    return values


def other_version(there: dict[str, Any], here: dict[str, Any]) -> str:
    """What is another in two environments and may change a result, the first of it; empty if nothing is.

    Beside versions that is `simd`: OpenBLAS, OpenCV, NumPy and the C library choose their code by what the processor
    has of AVX2 and AVX-512, and round otherwise. A library that one side lacks is none that the cell used. A
    description that comes from elsewhere may have anything in any place.
    """
    versions = [
        {**_part(side, "machine", "architecture", "simd"), **_part(side, "system", "libc"), **_part(side, "libraries"),
         **_part(side, "distributions")}
        for side in (there, here)
    ]  # fmt: skip
    for name in sorted(versions[0].keys() & versions[1].keys() - _WITHOUT_NUMBERS):
        if versions[0][name] != versions[1][name]:
            return f"{name} is {versions[0][name]} there, {versions[1][name]} here"
    return "" if "numpy" in versions[0].keys() & versions[1].keys() else "versions are not known"


def _part(environment: dict[str, Any], part: str, *names: str) -> dict[str, Any]:
    values = environment.get(part)
    values = values if isinstance(values, dict) else {}
    return {name: value for name, value in values.items() if not names or name in names}


def compared(cell: Cell, there: Values, here: Values, tolerance: float, other: str = "") -> Agreement:
    """What the values of a cell have in common with those that were computed here.

    other: what has another version here. Where all versions are equal nothing but equal values agree.
    """
    if there.keys() != here.keys():
        key = min(there.keys() ^ here.keys(), key=str)
        side = "not measured here" if key in there else "measured here alone"
        return Agreement(cell, "differs", len(there), f"{_named(key)}: {side}")
    apart = {key: _distance(value, here[key]) for key, value in there.items()}
    if not apart:
        return Agreement(cell, "not recomputed", 0, "it measured nothing that comes out the same twice")
    unequal = [key for key, distance in apart.items() if distance > 0.0]
    if not unequal:
        return Agreement(cell, "to the bit", len(there))
    beyond = [key for key in unequal if not other or apart[key] > tolerance]
    first = (beyond or unequal)[0]
    verdict: Verdict = "differs" if beyond else "within tolerance"
    note = (
        f"{_named(first)}: {there[first]!r} there, {here[first]!r} here; {len(unequal)} of {len(there)} values differ"
    )
    return Agreement(cell, verdict, len(there), f"{note}; {other or 'versions and instructions are equal'}")


def _distance(first: float, second: float) -> float:
    """The relative difference; 0 of values that are the same, missing and infinite ones too."""
    if first == second or (math.isnan(first) and math.isnan(second)):
        return 0.0
    distance = abs(first - second) / max(abs(first), abs(second))
    return distance if math.isfinite(distance) else math.inf


def _named(key: tuple[str, str, int | None, int]) -> str:
    metric, stage, frame, _ = key
    name = f"{metric}/{stage}" if stage else metric
    return name if frame is None else f"{name} of frame {frame}"
