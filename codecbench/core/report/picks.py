"""What to take of each codec, in one compact table in the order of the answer: what people read first, and paste."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import groupby
from typing import Final

from codecbench.core.analysis.choosing import Demand, links_with_readers
from codecbench.core.analysis.passing import Level, Standing, Test, parts
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.engine.text import counted
from codecbench.core.report.answers import Answers, anchor_of
from codecbench.core.report.choosing import link_picks
from codecbench.core.report.costs import coding_ms, rate_cell, spent, times_decide
from codecbench.core.report.formatting import Verdict, compact, rounded, without_pick
from codecbench.core.report.tables import aligned, short_table

_COLUMNS: Final = 8
"""Of a table of every setting, as a screen is no wider."""


def picks(run: RunResult, found: Answers) -> list[Verdict]:
    """The pick of each codec by an answer of the run, and over the links by which it is judged; if by nothing, what was
    measured of each setting."""
    tables = [_of_answers(run, found)] if found.answers else [] if found.table is None else [found.table]
    over = link_picks(run, Demand("")) if links_with_readers(run) else []
    return [*tables, *over] or [_of_settings(run)]


def _of_settings(run: RunResult) -> Verdict:
    """The first headlines of each setting."""
    frame = short_table(run, brief=True)
    heads = [str(name).replace("\n", " ") for name in frame.columns][:_COLUMNS]
    rows = [[_text(value) for value in row] for row in frame.itertuples(index=False)]
    table = compact(f"Every setting of {run.plan.name}", [dict(zip(heads, row, strict=False)) for row in rows])
    more = frame.shape[1] - len(heads)
    told = (f"{counted(more, 'more column')}: `codecbench table` shows them.",) if more else ()
    return replace(table, sentences=table.sentences + told)


def _text(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else "∞" if math.isinf(value) else aligned(value)
    return str(value)


def _of_answers(run: RunResult, found: Answers) -> Verdict:
    """A row for each codec that has a pick; if none has, what comes nearest of each."""
    picked = [each for each in found.answers if each.limit.lowest is not None]
    anchor = anchor_of(run, found)
    rows = []
    for each in picked or found.answers:
        row, setting, after = {"codec": each.curve}, each.shown, each.limit.next
        if setting is not None:
            row |= {"setting": setting.point, **_costs(run, found.on, each.curve, setting)}
            if anchor is not None and anchor.shown is not None:
                beside = spent(run, found.on, anchor.curve, anchor.shown)
                more = 100.0 * (spent(run, found.on, each.curve, setting) / beside - 1.0)
                row[f"vs. {anchor.curve}"] = "" if each is anchor else f"{rounded(more)} %"
            row |= measured(setting)
            row |= {"next coarser": _next(after)} if picked else {"verdict": setting.verdict}
        rows.append(row)
    table = compact(f"The pick of each codec, {found.over}", rows)
    others = [each for each in found.answers if picked and each not in picked and not each.limit.reason]
    without = without_pick([each.curve for each in others if each.passes is False], [each.curve for each in others])
    unjudged = (each.sentence for each in found.answers if each.limit.reason)
    return replace(table, sentences=(*table.sentences, *without, *unjudged))


def _next(after: Test | None) -> str:
    return "none tried" if after is None else f"{after.point} {after.verdict}".strip()


def _costs(run: RunResult, on: str, curve: str, test: Test) -> dict[str, str]:
    """Milliseconds a frame if they decide, and the bit rate, or the rate if that is not known."""
    encode_ms, decode_ms = map(aligned, coding_ms(run, on, curve, test))
    times = {"encode ms": encode_ms, "decode ms": decode_ms} if times_decide(run) else {}
    return times | dict([rate_cell(run, on, curve, test)])


def measured(test: Test) -> dict[str, str]:
    """What a setting reached by each test that it had to pass; of several tests of one name, the least sure."""
    named = groupby(sorted(parts(test), key=lambda part: part.label), key=lambda part: part.label)
    return dict(_reached(min(alike, key=_sureness)) for _, alike in named)


def _sureness(part: Standing | Level) -> float:
    return part.margin.mean if isinstance(part, Level) else part.interval[0]


def _reached(part: Standing | Level) -> tuple[str, str]:
    if isinstance(part, Standing):
        return "runs", f"{part.successes}/{part.runs}"
    return part.column.short_heading.replace("\n", " "), _sure(part)


def _sure(part: Level) -> str:
    """`0.914 ± 0.008`, both with as many digits after the point."""
    value = aligned(part.column.factor * part.value)
    if not 0.0 < part.reach < math.inf:
        return value
    reach = f"{part.reach:.{len(value.partition('.')[2])}f}"
    return f"{value} ± {reach if float(reach) else f'{part.reach:.1g}'}"
