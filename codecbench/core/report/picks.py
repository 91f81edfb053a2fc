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
from codecbench.core.report.formatting import (
    Verdict,
    compact_table,
    curves_without_pick,
    format_percent,
    search_verdicts,
)
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
"""Columns of a table of every setting, which a screen can show."""


def picks(run: RunResult, answer_set: Answers) -> list[Verdict]:
    """The pick of each codec by an answer of the run, and over its links; without criteria, all settings."""
    tables = (
        [_pick_table(run, answer_set)] if answer_set.answers else [] if answer_set.table is None else [answer_set.table]
    )
    over = link_picks(run, Demand("")) if links_with_readers(run) else []
    return [*tables, *over] or [_setting_table(run)]


def _setting_table(run: RunResult) -> Verdict:
    """The first headlines of each setting."""
    frame = short_table(run, brief=True)
    heads = [str(name).replace("\n", " ") for name in frame.columns][:_COLUMNS]
    rows = [[_text(value) for value in row] for row in frame.itertuples(index=False)]
    table = compact_table(f"Every setting of {run.plan.name}", [dict(zip(heads, row, strict=False)) for row in rows])
    more = frame.shape[1] - len(heads)
    hint = (f"{counted(more, 'more column')}: `codecbench table` shows them.",) if more else ()
    return replace(table, sentences=table.sentences + hint)


def _text(value: object) -> str:
    if isinstance(value, float):
        return "" if math.isnan(value) else "∞" if math.isinf(value) else padded_digits(value)
    return str(value)


def _pick_table(run: RunResult, answer_set: Answers) -> Verdict:
    """A row for each codec that has a pick; if none has, the nearest setting of each."""
    picked = [answer for answer in answer_set.answers if answer.limit.lowest is not None]
    anchor = anchor_of(run, answer_set)
    rows = []
    for answer in picked or answer_set.answers:
        row, setting, after = {"codec": answer.curve}, answer.setting, answer.limit.next
        if setting is not None:
            row |= {"setting": setting.point, **_costs(run, answer_set.on, answer.curve, setting)}
            if anchor is not None and anchor.setting is not None:
                cost_of_anchor = deciding_cost(run, answer_set.on, anchor.curve, anchor.setting)
                more = 100.0 * (deciding_cost(run, answer_set.on, answer.curve, setting) / cost_of_anchor - 1.0)
                row[f"vs. {anchor.curve}"] = "" if answer is anchor else f"{format_percent(more)} %"
            row |= measured_values(setting)
            row |= {"next coarser": _next(after)} if picked else {"verdict": setting.verdict}
        rows.append(row)
    table = compact_table(f"The pick of each codec, {answer_set.over}", rows)
    others = [answer for answer in answer_set.answers if picked and answer not in picked and not answer.limit.reason]
    failing = [answer.curve for answer in others if answer.passes is False]
    without = curves_without_pick(failing, [answer.curve for answer in others])
    unjudged = (answer.sentence for answer in answer_set.answers if answer.limit.reason)
    return replace(table, sentences=(*table.sentences, *without, *unjudged))


def _next(after: Test | None) -> str:
    return "none tried" if after is None else f"{after.point} {after.verdict}".strip()


def _costs(run: RunResult, on: str, curve: str, test: Test) -> dict[str, str]:
    """Milliseconds a frame if they decide, and the bit rate, or the rate if no bit rate is known."""
    encode_ms, decode_ms = map(padded_digits, coding_ms(run, on, curve, test))
    times = {"encode ms": encode_ms, "decode ms": decode_ms} if times_decide(run) else {}
    return times | dict([rate_cell(run, on, curve, test)])


def measured_values(test: Test) -> dict[str, str]:
    """The values of a setting by each test that it had to pass; of several tests of one name, the least sure."""
    by_label = groupby(sorted(parts(test), key=lambda part: part.label), key=lambda part: part.label)
    return dict(_cell(min(alike, key=_sureness)) for _, alike in by_label)


def _sureness(part: Standing | Level) -> float:
    return part.margin.mean if isinstance(part, Level) else part.interval[0]


def _cell(part: Standing | Level) -> tuple[str, str]:
    if isinstance(part, Standing):
        return "runs", f"{part.successes}/{part.runs}"
    return part.column.short_heading.replace("\n", " "), _value_words(part)


def _value_words(part: Level) -> str:
    """`0.914 ± 0.008`, both with equally many digits after the point, and what is shown beside them."""
    value = padded_digits(part.column.factor * part.value)
    if not 0.0 < part.reach < math.inf:
        return value + part.beside_words
    reach = f"{part.reach:.{len(value.partition('.')[2])}f}"
    return f"{value} ± {reach if float(reach) else f'{part.reach:.1g}'}{part.beside_words}"


def answer_tables(run: RunResult) -> list[Verdict]:
    """The findings of searches, the table of picks, and last the answer."""
    answer_set = answers(run)
    answer = Verdict("answer", (), (), tuple(answer_set.sentence.splitlines()))
    return [*search_verdicts(run, brief=True), *picks(run, answer_set), answer]


def text_to_paste(run: RunResult, verdicts: Sequence[Verdict], format_: str) -> str:
    """Verdicts on a run as `markdown` or `latex`, after the notes on calibrations and settings.

    In latex, everything except tables is a comment."""
    notes = [*calibration_notes(run), *setting_notes(run)]
    sections = [*([Verdict("notes", (), (), tuple(notes))] if notes else []), *verdicts]
    return "\n".join(_latex(verdict) if format_ == "latex" else _markdown(verdict) for verdict in sections)


def _markdown(verdict: Verdict) -> str:
    table = f"{foreign_table(verdict.heads, verdict.rows)}\n" if verdict.rows else ""
    sentences = "".join(f"- {escape(sentence)}\n" for sentence in verdict.sentences)
    return f"### {escape(verdict.title)}\n\n{table}{sentences}"


def _latex(verdict: Verdict) -> str:
    frame = pd.DataFrame(verdict.rows, columns=list(verdict.heads))
    table = export_table(frame, "latex").decode() if verdict.rows else ""
    comments = [f"% {' '.join(text.split())}\n" for text in (verdict.title, *verdict.sentences)]
    return "".join((comments[0], table, *comments[1:]))
