"""The terminal as rich draws on it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text


class Screen(Console):
    """A console whose reader may stop reading: that is an error like any other, and does not end the process here."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def plain_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table without lines, that breaks no word as long as its longest words stand beside each other."""
    console = Screen()
    rows = list(rows)
    table = Table(show_edge=False, header_style="dim", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    columns = [[head, *(row[place] for row in rows)] for place, head in enumerate(heads)]
    for head, width in zip(heads, _widths(columns, console.width - 2 * (len(heads) - 1)), strict=True):
        table.add_column(Text(head), width=width, overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)


def _widths(columns: Sequence[Sequence[str]], room: int) -> list[int]:
    """As wide as each column's longest text; where that is too wide, the widest are narrowed, first to whole words."""
    widths = [max(len(line) for text in texts for line in text.splitlines() or [""]) for texts in columns]
    words = [max(len(word) for text in texts for word in text.split() or [""]) for texts in columns]
    while sum(widths) > max(room, len(widths)):
        narrowed = max(range(len(widths)), key=lambda column: (widths[column] > words[column], widths[column]))
        widths[narrowed] -= 1
    return widths
