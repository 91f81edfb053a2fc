"""What a run could decide, as tables and sentences for people."""

from __future__ import annotations

import math
from itertools import groupby

from codecbench.core.results.columns import Column
from codecbench.core.results.paired_difference import POWER
from codecbench.core.results.ranking.power import LimitPower, PairPower, limit_powers, pair_powers
from codecbench.core.results.ranking.words import Verdict, successes, where
from codecbench.core.results.run_result import RunResult

_PAIR_HEADS = ("codecs", "difference", "smallest shown", "says", "would tell")
_LIMIT_HEADS = ("setting", "runs that succeed", "told from", "says", "would tell")


def power_verdicts(run: RunResult, power: float = POWER) -> list[Verdict]:
    """A table for each ranking, of its pairs, and one for each sequence and success, of its settings."""
    pairs = groupby(pair_powers(run, power), key=lambda pair: (pair.column.name, pair.sequence))
    found = [_of_pairs(list(members)) for _, members in pairs]
    for columns in successes(run):
        powers = sorted(limit_powers(run, columns, power), key=lambda limit: limit.sequence)
        found += [_of_limits(list(members)) for _, members in groupby(powers, key=lambda limit: limit.sequence)]
    return found


def _of_pairs(pairs: list[PairPower]) -> Verdict:
    first = pairs[0]
    of = " and ".join(first.of)
    title = f"{where(first.sequence)}: {first.column.label}, {first.units} {of}, found {_often(first.power)}"
    rows = tuple(
        (
            f"{pair.first} over {pair.second}",
            _amount(pair.difference, pair.column),
            "–" if math.isnan(pair.smallest) else _amount(pair.smallest, pair.column),
            _said(pair),
            _more(pair.more_units, of),
        )
        for pair in pairs
    )
    stood = sum(pair.stands for pair in pairs)
    sentences = [f"{stood} of {len(pairs)} differences stand at {first.level:.2g}, a share of 0.01 for each pair."]
    if first.column.metric.scale == "log" and first.column.metric.better == "lower":
        sentences.append("Differences are factors: of ×1.1 the second has 1.1 times as much.")
    return Verdict(title, _PAIR_HEADS, rows, tuple(sentences))


def _often(power: float) -> str:
    return f"in {100.0 * power:.3g} % of cases"


def _amount(difference: float, column: Column) -> str:
    """A difference in the unit that people are shown; of logarithms as a factor."""
    if column.metric.scale == "log" and column.metric.better == "lower":
        return f"×{10.0**difference:.3g}"
    unit = f" {column.unit}" if column.unit not in ("", "1") else ""
    return f"{difference * column.factor:+.3g}{unit}"


def _said(pair: PairPower) -> str:
    if pair.stands:
        return f"{pair.first if pair.difference > 0 else pair.second} is ahead"
    return "the same everywhere" if pair.difference == 0.0 and pair.evidence.variance == 0.0 else "cannot tell"


def _more(more: int | None, of: str) -> str:
    if more == 0:
        return "–"
    return f"more than a thousandfold {of}" if more is None else f"{more} more {of}"


def _of_limits(found: list[LimitPower]) -> Verdict:
    first = found[0]
    label = " and ".join(column.label for column in first.columns)
    title = f"{where(first.sequence)}: {label}, found {_often(first.power)}"
    rows = tuple(
        (
            f"{limit.curve} {limit.standing.point}".strip(),
            f"{limit.standing.successes}/{limit.standing.runs}",
            "–" if math.isnan(limit.told_from) else f"{100 * limit.told_from:.0f} %",
            limit.standing.verdict,
            "–" if limit.more_runs == 0 else f"{limit.more_runs} more runs at best",
        )
        for limit in found
    )
    stood = sum(limit.more_runs == 0 for limit in found)
    return Verdict(title, _LIMIT_HEADS, rows, (f"{stood} of {len(found)} verdicts stand at 95 %.",))
