"""The table of picks, one of each codec in the order of the answer, and its text to paste as Markdown or LaTeX."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import groupby
from typing import Final

import pandas as pd

from codecbench.core.analysis.choosing import Demand, links_with_readers
from codecbench.core.analysis.passing import Level, Standing, Test, parts
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.engine.text import counted
from codecbench.core.report.answers import Answers, anchor_of, answers
from codecbench.core.report.choosing import link_picks
from codecbench.core.report.costs import coding_ms, deciding_cost, rate_cell, times_decide
from codecbench.core.report.formatting import Verdict, compact_table, format_percent, search_verdicts, without_pick
from codecbench.core.report.tables import (
    calibration_notes,
    escape,
    export_table,
    foreign_table,
    padded_digits,
    setting_notes,
    short_table,
)

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
    table = compact_table(f"Every setting of {run.plan.name}", [dict(zip(heads, row, strict=False)) for row in rows])
    more = frame.shape[1] - len(heads)
    told = (f"{counted(more, 'more column')}: `codecbench table` shows them.",) if more else ()
    return replace(table, sentences=table.sentences + told)


def _text(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else "∞" if math.isinf(value) else padded_digits(value)
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
                beside = deciding_cost(run, found.on, anchor.curve, anchor.shown)
                more = 100.0 * (deciding_cost(run, found.on, each.curve, setting) / beside - 1.0)
                row[f"vs. {anchor.curve}"] = "" if each is anchor else f"{format_percent(more)} %"
            row |= measured_values(setting)
            row |= {"next coarser": _next(after)} if picked else {"verdict": setting.verdict}
        rows.append(row)
    table = compact_table(f"The pick of each codec, {found.over}", rows)
    others = [each for each in found.answers if picked and each not in picked and not each.limit.reason]
    without = without_pick([each.curve for each in others if each.passes is False], [each.curve for each in others])
    unjudged = (each.sentence for each in found.answers if each.limit.reason)
    return replace(table, sentences=(*table.sentences, *without, *unjudged))


def _next(after: Test | None) -> str:
    return "none tried" if after is None else f"{after.point} {after.verdict}".strip()


def _costs(run: RunResult, on: str, curve: str, test: Test) -> dict[str, str]:
    """Milliseconds a frame if they decide, and the bit rate, or the rate if that is not known."""
    encode_ms, decode_ms = map(padded_digits, coding_ms(run, on, curve, test))
    times = {"encode ms": encode_ms, "decode ms": decode_ms} if times_decide(run) else {}
    return times | dict([rate_cell(run, on, curve, test)])


def measured_values(test: Test) -> dict[str, str]:
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
    value = padded_digits(part.column.factor * part.value)
    if not 0.0 < part.reach < math.inf:
        return value
    reach = f"{part.reach:.{len(value.partition('.')[2])}f}"
    return f"{value} ± {reach if float(reach) else f'{part.reach:.1g}'}"


def answer_tables(run: RunResult) -> list[Verdict]:
    """What searches have found, the table of picks, and last the answer."""
    found = answers(run)
    answer = Verdict("answer", (), (), tuple(found.sentence.splitlines()))
    return [*search_verdicts(run, brief=True), *picks(run, found), answer]


def text_to_paste(run: RunResult, found: Sequence[Verdict], format_: str) -> str:
    """Verdicts on a run as `markdown` or `latex`, in which what stands around a table is a comment; first what is noted
    of calibrations and settings, as numbers are not to be read without it."""
    notes = [*calibration_notes(run), *setting_notes(run)]
    every = [*([Verdict("notes", (), (), tuple(notes))] if notes else []), *found]
    return "\n".join(_latex(verdict) if format_ == "latex" else _markdown(verdict) for verdict in every)


def _markdown(verdict: Verdict) -> str:
    table = f"{foreign_table(verdict.heads, verdict.rows)}\n" if verdict.rows else ""
    sentences = "".join(f"- {escape(sentence)}\n" for sentence in verdict.sentences)
    return f"### {escape(verdict.title)}\n\n{table}{sentences}"


def _latex(verdict: Verdict) -> str:
    frame = pd.DataFrame(verdict.rows, columns=list(verdict.heads))
    table = export_table(frame, "latex").decode() if verdict.rows else ""
    comments = [f"% {' '.join(text.split())}\n" for text in (verdict.title, *verdict.sentences)]
    return "".join((comments[0], table, *comments[1:]))
