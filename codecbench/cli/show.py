"""Tables in the terminal."""

from __future__ import annotations

import math
from collections import Counter
from typing import TYPE_CHECKING, Final, Literal

import click
import pandas as pd
from rich.table import Table
from rich.text import Text

from codecbench.cli.screen import Screen

if TYPE_CHECKING:
    from codecbench.core.analysis.run_result import RunResult

_MOST_ROWS: Final = 400
_LEADING: Final = ("sequence", "codec", "setting")
"""Columns that say which row is which, in every part of a table too wide for the screen."""
_FOLDED: Final = 40
"""Characters: longer texts are folded."""
_FRAME: Final = 3
"""Characters that a column takes beside its text."""


def show_summary(result: RunResult) -> None:
    """What evaluators declare as their headlines, the numbers that most people ask for first, and what is noted."""
    from codecbench.core.report.tables import notes, short_table

    show_table(short_table(result, brief=True), result)
    for note in notes(result):
        click.secho(note, fg="yellow")


def show_reasons(result: RunResult) -> None:
    """Why cells have no result: each reason once, with how many cells gave it."""
    unmeasured = Counter((cell.status, cell.reason) for cell in result.results if cell.status != "ok")
    for (status, reason), count in unmeasured.most_common():
        click.secho(f"{status} ({count}): {reason}", fg="yellow")


def show_table(frame: pd.DataFrame, result: RunResult) -> None:
    """A table in the terminal, in as many parts as its width takes; long ones end with how many rows were left out."""
    console = Screen()
    if not console.is_terminal:
        console = Screen(width=160)
    texts = [[_cell(value) for value in row] for row in frame.head(_MOST_ROWS).itertuples(index=False)]
    heads = [str(name).replace(".", "\n") for name in frame.columns]
    numeric = [pd.api.types.is_numeric_dtype(kind) for kind in frame.dtypes]
    for part in _parts(heads, texts, [str(name) in _LEADING for name in frame.columns], console.width):
        table = Table(title=Text(result.plan.name), title_justify="left", header_style="bold", row_styles=["", "dim"])
        for column in part:
            side: Literal["left", "right"] = "right" if numeric[column] else "left"
            table.add_column(Text(heads[column]), justify=side, no_wrap=numeric[column], overflow="fold")
        for row in texts:
            table.add_row(*(Text(row[column]) for column in part))
        console.print(table)
    if len(frame) > _MOST_ROWS:
        console.print(f"... and {len(frame) - _MOST_ROWS} more rows; use --format csv for all of them")


def _parts(heads: list[str], texts: list[list[str]], leading: list[bool], width: int) -> list[list[int]]:
    """Columns of each part: the leading ones in every part, the others in order, as many as fit."""
    widths = [
        min(_FOLDED, max(len(line) for text in (head, *(row[column] for row in texts)) for line in text.split("\n")))
        + _FRAME
        for column, head in enumerate(heads)
    ]
    first = [column for column, leads in enumerate(leading) if leads]
    parts = [list(first)]
    left = room = width - sum(widths[column] for column in first) - 1
    for column in (column for column, leads in enumerate(leading) if not leads):
        if widths[column] > left and len(parts[-1]) > len(first):
            parts.append(list(first))
            left = room
        parts[-1].append(column)
        left -= widths[column]
    return parts


def _cell(value: object) -> str:
    if value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, float):
        return "∞" if math.isinf(value) else f"{value:.4g}"
    return str(value)
