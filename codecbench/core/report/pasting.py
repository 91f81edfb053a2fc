"""Tables and sentences as Markdown and LaTeX, to paste."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.answers import answers
from codecbench.core.report.formatting import Verdict, searched
from codecbench.core.report.picks import picks
from codecbench.core.report.tables import calibration_notes, escaped, exported, foreign_table, setting_notes


def answer_tables(run: RunResult) -> list[Verdict]:
    """What searches have found, the table of picks, and last the answer."""
    found = answers(run)
    answer = Verdict("answer", (), (), tuple(found.sentence.splitlines()))
    return [*searched(run, brief=True), *picks(run, found), answer]


def pasted(run: RunResult, found: Sequence[Verdict], format_: str) -> str:
    """Verdicts on a run as `markdown` or `latex`, in which what stands around a table is a comment; first what is noted
    of calibrations and settings, as numbers are not to be read without it."""
    notes = [*calibration_notes(run), *setting_notes(run)]
    every = [*([Verdict("notes", (), (), tuple(notes))] if notes else []), *found]
    return "\n".join(_latex(verdict) if format_ == "latex" else _markdown(verdict) for verdict in every)


def _markdown(verdict: Verdict) -> str:
    table = f"{foreign_table(verdict.heads, verdict.rows)}\n" if verdict.rows else ""
    sentences = "".join(f"- {escaped(sentence)}\n" for sentence in verdict.sentences)
    return f"### {escaped(verdict.title)}\n\n{table}{sentences}"


def _latex(verdict: Verdict) -> str:
    frame = pd.DataFrame(verdict.rows, columns=list(verdict.heads))
    table = exported(frame, "latex").decode() if verdict.rows else ""
    comments = [f"% {' '.join(text.split())}\n" for text in (verdict.title, *verdict.sentences)]
    return "".join((comments[0], table, *comments[1:]))
