"""The report's summary: one table a sequence, one row a curve, and in words who is ahead."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from codecbench.core.results.bjontegaard import BdRate
from codecbench.core.results.columns import Column
from codecbench.core.results.limits import Limit, limits
from codecbench.core.results.numbers import three_digits
from codecbench.core.results.ranking.ranking import Ranking, rankings
from codecbench.core.results.ranking.words import beside_ranking
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.verdicts import (
    SequenceCurve,
    anchors_of,
    bd_rates_by_anchor,
    pareto_criteria,
    pareto_settings,
    spread,
)

_LEADS: Final = "on the Pareto front"


@dataclass(frozen=True)
class _Judged:
    """What is said of every curve: BD-rates at equal values of some columns, and limits of others.

    rates: by column and anchor; "" is the only anchor, which each sequence has by itself.
    """

    rates: dict[tuple[Column, str], dict[SequenceCurve, BdRate]]
    limits: dict[Column, dict[SequenceCurve, Limit]]


def verdict_tables(run: RunResult) -> tuple[list[dict[str, Any]], str]:
    """A table for each sequence as the template takes it, and the names of the anchors of BD-rates, if any."""
    rates = {
        (column, anchor): found
        for column in run.headlines("quality", "task")
        for anchor, found in bd_rates_by_anchor(run, column).items()
    }
    judged = _Judged(
        {key: found for key, found in rates.items() if found},
        {column: limits(run, [column]) for column in run.headlines("success")},
    )
    ranges = [column for column in (run.rate, *run.headlines("quality")[:1]) if column is not None]
    times = run.headlines("time")
    heads = ["curve", "settings", "Pareto front", *(column.heading for column in ranges)]
    last_heads = [f"{column.label} down to" for column in judged.limits]
    last_heads += [column.heading for column in times]
    criteria = pareto_criteria(run)
    ranked = {(found.column, found.sequence): found for found in rankings(run)}
    tables, anchors = [], dict.fromkeys(anchor for _, anchor in judged.rates if anchor)
    for entry in run.plan.sequences:
        wide = run.wide[run.wide["sequence"] == entry.name]
        used, front = pareto_settings(wide, criteria)
        curves: dict[str, list[Any]] = {}
        for record, leads in zip(wide.to_dict("records"), front, strict=True):
            curve = run.curves[record["codec"], record["setting"]].curve
            curves.setdefault(curve, []).append({**record, _LEADS: leads})
        own = next(iter(anchors_of(curves, run.meaning.anchors)), "")
        if not any(anchor for _, anchor in judged.rates) and own:
            anchors[own] = None
        rows = []
        told = {key: found for key, found in judged.rates.items() if _has_number(found, entry.name)}
        for curve, records in curves.items():
            key = (entry.name, curve)
            row = [curve, str(len(records)), f"{sum(record[_LEADS] for record in records)} of {len(records)}"]
            row += [_range(records, column) for column in ranges]
            row += [
                "anchor" if curve == (anchor or own) else str(found.get(key, "–"))
                for (_, anchor), found in told.items()
            ]
            row += [found[key].words(run.rate) if key in found else "–" for found in judged.limits.values()]
            rows.append([*row, *(spread(_values(records, column)) for column in times)])
        note = f"Pareto front: settings that no other beats in all of {', '.join(used)}." if used else ""
        words = _in_words(entry.name, own, judged, run.rate, ranked)
        untold = _untold({key: found for key, found in judged.rates.items() if key not in told}, entry.name)
        bd_heads = [f"BD-rate{f' beside {anchor}' if anchor else ''}, {column.label}" for column, anchor in told]
        own_heads = [*heads, *bd_heads, *last_heads]
        tables.append(
            {"sequence": entry.name, "heads": own_heads, "rows": rows, "note": note, "words": words, "untold": untold}
        )
    return tables, " and ".join(anchors) if judged.rates else ""


def _has_number(found: dict[SequenceCurve, BdRate], sequence: str) -> bool:
    return any(name == sequence and not rate.reason for (name, _), rate in found.items())


def _untold(judged: dict[tuple[Column, str], dict[SequenceCurve, BdRate]], sequence: str) -> list[str]:
    """What has no BD-rate of any curve on a sequence, each reason once."""
    found: dict[str, list[str]] = {}
    for (column, _), rates in judged.items():
        for reason in [rate.reason for (name, _), rate in rates.items() if name == sequence][:1]:
            found.setdefault(reason.split(":")[0], []).append(column.label)
    return [
        f"No curve has a BD-rate at equal {', '.join(dict.fromkeys(labels))}: {reason}."
        for reason, labels in found.items()
    ]


def _in_words(
    sequence: str, own: str, judged: _Judged, rate: Column | None, ranked: dict[tuple[Column, str], Ranking]
) -> list[str]:
    """Who needs least rate on a sequence, for each thing held equal, and who holds down to the least."""
    words = []
    for (column, named), found in judged.rates.items():
        anchor = named or own
        here = {curve: bd for (name, curve), bd in found.items() if name == sequence and not bd.reason}
        if here:
            best = min(here, key=lambda curve: here[curve].percent)
            ahead = here[best].percent < 0.0
            text = f"{best} needs least rate: {here[best]} against {anchor}" if ahead else f"{anchor} needs least rate"
            ranking = ranked.get((column, sequence))
            doubt = beside_ranking(ranking, best, anchor) if ranking else ""
            words.append(f"At equal {column.label}, {text}{f' ({doubt})' if doubt else ''}.")
    for column, limited in judged.limits.items():
        held = {curve: limit for (name, curve), limit in limited.items() if name == sequence and limit.lowest}
        if held and rate is not None:
            least = min(held, key=lambda curve: held[curve].rate)
            subject = column.label[:1].upper() + column.label[1:]
            words.append(f"{subject} down to the least rate with {least}: {held[least].words(rate)}.")
    return words


def _values(records: list[Any], column: Column) -> np.ndarray:
    """A column in the unit that people are shown."""
    return np.array([float(record.get(column.name, np.nan)) * column.factor for record in records])


def _range(records: list[Any], column: Column) -> str:
    values = _values(records, column)
    values = values[~np.isnan(values)]
    if not len(values):
        return "–"
    low, high = values.min(), values.max()
    least, most = three_digits(low), three_digits(high)
    return (least if least == most else f"{least} to {most}").replace("inf", "∞")
