"""Whether the order of the baseline and a setting is one of codecs, or of calibrations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from codecbench.core.analysis.choosing import median
from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.evidence import SIGNIFICANCE, evidence_of_repeats
from codecbench.core.analysis.run_result import RunResult, judged_column
from codecbench.core.analysis.verdicts import Place, as_quality, values_of_repeats

Medians = tuple[float, float]
"""Of a setting and of the baseline, over the repeats that both have."""


@dataclass(frozen=True)
class Orders:
    """A setting beside the baseline: the sequences on which it is significantly better, and those on which worse."""

    setting: str
    better: Mapping[str, Medians]
    worse: Mapping[str, Medians]

    @property
    def turns(self) -> bool:
        return bool(self.better and self.worse)

    @property
    def told(self) -> bool:
        """Whether there is an order on two sequences or more."""
        return len(self.better) + len(self.worse) > 1


@dataclass(frozen=True)
class Calibrations:
    """A sequence that a run also has under wrong calibrations (others), and how settings stand there by a column.

    medians: of the baseline over repeats, by sequence, where it has a value; without a baseline there are no settings.
    """

    sequence: str
    others: tuple[str, ...]
    baseline: str
    medians: Mapping[str, float]
    column: Column
    settings: tuple[Orders, ...]


def calibrations(run: RunResult) -> Iterator[Calibrations]:
    """Every sequence of a run that it has under several calibrations, if there is anything to judge by.

    An order is one by the paired t-test over repeats; a repeat that either lacks does not count.
    """
    column = judged_column(run)
    if run.as_calibrated is run or column is None:
        return
    values = values_of_repeats(run, column)
    raw = next((key for key in run.curves if key[0] in run.schema.baselines), ("", ""))
    tried = [key for key in run.curves if raw[0] and key[0] not in run.schema.baselines]
    for entry in run.as_calibrated.plan.sequences:
        others = tuple(each.name for each in run.plan.sequences if each.as_calibrated == entry.fingerprint)
        if others:
            on = {name: values.get((name, *raw), {}) for name in (entry.name, *others)}
            medians = {name: value for name, own in on.items() if not math.isnan(value := median(own.values()))}
            settings = tuple(
                _orders(key, {name: _beside(values.get((name, *key), {}), on[name], column) for name in on})
                for key in tried
            )
            yield Calibrations(entry.name, others, raw[0], medians, column, settings)


def _orders(key: tuple[str, str], beside: Mapping[str, tuple[int, Medians]]) -> Orders:
    better, worse = ({name: both for name, (sign, both) in beside.items() if sign == wanted} for wanted in (1, -1))
    return Orders(" ".join(key).strip(), better, worse)


def _beside(own: Mapping[Place, float], raw: Mapping[Place, float], column: Column) -> tuple[int, Medians]:
    """Whether a setting is better than the baseline (1) or worse (-1), or neither is known (0); medians of both."""
    pairs = np.array([(own[place], raw[place]) for place in own if place in raw]).reshape(-1, 2)
    better = -np.diff(as_quality(pairs, column), axis=1)[:, 0]
    pairs, better = pairs[np.isfinite(better)], better[np.isfinite(better)]
    if not len(better):
        return 0, (np.nan, np.nan)
    found = evidence_of_repeats(better)
    own_median, raw_median = np.median(pairs, axis=0)
    return int(np.sign(found.mean)) * (found.p_value < SIGNIFICANCE), (float(own_median), float(raw_median))
