"""Tables of a run in the terminal."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Callable
from typing import TYPE_CHECKING, Final

import pandas as pd
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from codecbench.cli.display import Screen
from codecbench.cli.messages import say
from codecbench.core.report import tables

if TYPE_CHECKING:
    from codecbench.core.analysis.run_result import RunResult

_MOST_ROWS: Final = 400
_LEADING: Final = ("sequence", "codec", "setting")
"""Columns that identify a row, repeated in every part of a table that is too wide for the screen."""
_FOLDED: Final = 40
"""Longer texts are folded; in characters."""
_BETWEEN: Final = 2
"""Space between two columns, in characters."""


def show_summary(result: RunResult) -> None:
    """Print the primary metrics of the evaluators as a table, and notes."""
    frame, same = tables.drop_constant_columns(tables.short_table(result, brief=True))
    left_out = show_table(frame, result.plan.name, brief=True)
    if same:
        say(same)
    if left_out:
        say(f"columns that do not fit: {', '.join(left_out)}; --all shows them")
    for note in tables.notes(result):
        say(note, fg="yellow")


def show_reasons(result: RunResult) -> None:
    """Print why cells have no result: each reason once, with its number of cells."""
    unmeasured = Counter((cell.status, cell.reason) for cell in result.results if cell.status != "ok")
    for (status, reason), count in unmeasured.most_common():
        say(f"{status} ({count}): {reason}", fg="yellow")


def show_table(frame: pd.DataFrame, title: str = "", *, brief: bool = False) -> list[str]:
    """Print a table in as many parts as its width needs; a long one ends with the number of rows left out.

    brief: print one part with the columns that fit and return the names of the others. Texts are folded at their words,
    those of `_LEADING` too if they would take more than half of the screen.
    """
    console = Screen()
    texts = [[tables.format_value(value) for value in row] for row in frame.head(_MOST_ROWS).itertuples(index=False)]
    names = [str(name) for name in frame.columns]
    numeric = [pd.api.types.is_numeric_dtype(kind) for kind in frame.dtypes]
    leading = [name in _LEADING for name in names]
    heads = [name.replace(".", "\n") for name in names]
    columns = [[head, *(row[column] for row in texts)] for column, head in enumerate(heads)]
    words, widths = _widths(columns, str.split), _widths(columns, str.splitlines)
    if brief:
        roomy = 2 * sum(width for width, leads in zip(widths, leading, strict=True) if leads) <= console.width
        widths = [width if leads and roomy else word for word, width, leads in zip(words, widths, leading, strict=True)]
    parts = _parts(widths, leading, console.width, brief)
    for part in parts:
        table = Table(
            title=Text(title) if title else None, title_justify="left", header_style="bold", row_styles=["", "dim"],
            box=SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True,
        )  # fmt: skip
        for column in part:
            table.add_column(
                Text(_wrap(heads[column], widths[column])), justify="right" if numeric[column] else "left",
                no_wrap=numeric[column], overflow="fold", max_width=widths[column],
            )  # fmt: skip
        for row in texts:
            table.add_row(*(Text(row[column]) for column in part))
        console.print(table)
    if len(frame) > _MOST_ROWS:
        say(f"... and {len(frame) - _MOST_ROWS} more rows; use --format csv for all of them")
    return [" ".join(name.split()) for column, name in enumerate(names) if not any(column in part for part in parts)]


def _widths(columns: list[list[str]], parts: Callable[[str], list[str]]) -> list[int]:
    """Return the width of each column of a head and texts: its longest part of a text, or word of the head."""
    return [
        min(_FOLDED, max(len(part) for part in (*head.split(), *(part for text in texts for part in parts(text)), " ")))
        for head, *texts in columns
    ]


def _wrap(head: str, width: int) -> str:
    return "\n".join(textwrap.fill(line, width) for line in head.split("\n"))


def _parts(widths: list[int], leading: list[bool], screen: int, brief: bool) -> list[list[int]]:
    """Return the columns of each part: the leading ones in every part, the others in order, as many as fit.

    brief: return one part, without the columns that do not fit.
    """
    repeated = [column for column, leads in enumerate(leading) if leads]
    parts = [list(repeated)]
    left = room = screen + _BETWEEN - sum(widths[column] + _BETWEEN for column in repeated)
    for column in (column for column, leads in enumerate(leading) if not leads):
        if widths[column] + _BETWEEN > left and len(parts[-1]) > len(repeated):
            if brief:
                continue
            parts.append(list(repeated))
            left = room
        parts[-1].append(column)
        left -= widths[column] + _BETWEEN
    return parts
