"""Codecs in order at one rate: by a metric that is measured frame by frame, with what is only chance told apart."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from codecbench.core.results.blocks import SIGNIFICANCE, PairedDifference, paired_difference
from codecbench.core.results.columns import Column
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.table import CellResult
from codecbench.core.results.verdicts import frame_matrix

Values = NDArray[np.float64]


@dataclass(frozen=True)
class Standing:
    """A curve in the order at a rate.

    mean: of the metric at that rate. ahead: of the next curve, by how much. p_value: of that lead, corrected for all
    pairs that are compared (Holm 1979). group: curves of one group cannot be told apart from a neighbour in it.
    """

    curve: str
    mean: float
    ahead: PairedDifference | None
    p_value: float
    group: int


def order_at_rate(run: RunResult, column: Column, sequence: str, rate: float) -> list[Standing]:
    """Curves by a per-frame metric at a rate, best first; those that do not reach around the rate are left out.

    A frame's value at the rate is interpolated between the two settings whose mean rates enclose it, linearly over the
    logarithm of the rate; frames are then compared one by one.
    """
    curves = curves_of_frames(run, column, sequence)
    sign = -1.0 if column.metric.better == "lower" else 1.0
    values = {curve: at_rate(*arrays, rate) for curve, arrays in curves.items()}
    return standings({curve: found for curve, found in values.items() if found is not None}, sign)


def standings(values: Mapping[str, Values], sign: float = 1.0) -> list[Standing]:
    """Curves in order of the means of their frames' values, the greatest first where `sign` is 1.

    values: (N,) of the same frames for each curve; frames that one of them lacks count for none.
    """
    if not values:
        return []
    whole = np.isfinite(np.array(list(values.values()))).all(axis=0)
    means = {curve: float(found[whole].mean()) if whole.any() else float("nan") for curve, found in values.items()}
    order = sorted(means, key=lambda curve: -sign * means[curve])
    pairs = {pair: paired_difference(*(values[curve][whole] for curve in pair)) for pair in combinations(order, 2)}
    corrected = dict(zip(pairs, holm([pair.p_value for pair in pairs.values()]), strict=True))
    found, group = [], 0
    for pair in pairwise([*order, ""]):
        chance = corrected.get(pair, float("nan"))
        found.append(Standing(pair[0], means[pair[0]], pairs.get(pair), chance, group))
        group += chance < SIGNIFICANCE
    return found


def at_rate(rates: Values, values: Values, rate: float) -> Values | None:
    """(N,) values of frames at a rate between settings, or None outside of them. rates: (S,) means, values: (S, N)."""
    order = np.argsort(rates, kind="stable")
    rates, values = rates[order], values[order]
    if not len(rates) or not np.isfinite(rates).all() or not rates[0] <= rate <= rates[-1]:
        return None
    above = min(int(np.searchsorted(rates, rate)), len(rates) - 1)
    below = max(above - 1, 0)
    if rates[above] == rates[below]:
        return np.asarray(values[above])
    share = np.log(rate / rates[below]) / np.log(rates[above] / rates[below])
    return np.asarray((1.0 - share) * values[below] + share * values[above])


def curves_of_frames(run: RunResult, column: Column, sequence: str) -> dict[str, tuple[Values, Values]]:
    """Mean rates (S,) and per-frame values (S, N) of each curve of several settings on a sequence."""
    members: dict[str, list[CellResult]] = defaultdict(list)
    for result in run.of(column.evaluator.title):
        cell = result.cell
        if cell.sequence.name == sequence:
            members[run.curves[cell.codec.name, cell.codec.label].curve].append(result)
    curves = {}
    for curve, results in members.items():
        rates = [run.rates[sequence, result.cell.codec.name, result.cell.codec.label] for result in results]
        if len(results) > 1:
            curves[curve] = np.array(rates), frame_matrix(results, column.metric.name, column.stage)[1]
    return curves


def holm(p_values: list[float]) -> list[float]:
    """p-values corrected for their number, in the same order (Holm, Scandinavian J. of Statistics 6(2), 1979)."""
    corrected, worst = [0.0] * len(p_values), 0.0
    for rank, position in enumerate(np.argsort(p_values, kind="stable")):
        worst = max(worst, min(1.0, (len(p_values) - rank) * p_values[position]))
        corrected[position] = worst
    return corrected
