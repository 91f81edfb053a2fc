"""The terminal as rich draws on it: plain tables, and the progress of a run."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Final

import click
from rich.console import Console, RenderableType
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as ProgressBar
from rich.table import Table
from rich.text import Text

from codecbench.cli.messages import say
from codecbench.core.engine.text import clean_line

if TYPE_CHECKING:
    from codecbench.core.engine.running.progress import Progress


class Screen(Console):
    """A console that raises BrokenPipeError if its reader stops reading, where rich would end the process."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


def plain_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table without rules. It breaks no word as long as the longest words of all columns fit side by side."""
    console = Screen()
    rows = list(rows)
    table = Table(show_edge=False, header_style="dim", box=None, pad_edge=False, padding=(0, 2, 0, 0))
    columns = [[head, *(row[column] for row in rows)] for column, head in enumerate(heads)]
    for head, width in zip(heads, _widths(columns, console.width - 2 * (len(heads) - 1)), strict=True):
        table.add_column(Text(head), width=width, overflow="fold")
    for row in rows:
        table.add_row(*(Text(cell) for cell in row))
    console.print(table)


def _widths(columns: Sequence[Sequence[str]], room: int) -> list[int]:
    """Return a width for each column: that of its longest text, or less for the widest, first down to whole words."""
    widths = [max(len(line) for text in texts for line in text.splitlines() or [""]) for texts in columns]
    words = [max(len(word) for text in texts for word in text.split() or [""]) for texts in columns]
    while sum(widths) > max(room, len(widths)):
        narrowed = max(range(len(widths)), key=lambda column: (widths[column] > words[column], widths[column]))
        widths[narrowed] -= 1
    return widths


_LINE_EVERY_S: Final = 60.0


class _Bar(ProgressBar):
    """A progress bar with the latest measurement below it."""

    measured = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        yield Text(self.measured, style="dim", no_wrap=True, overflow="ellipsis")


class Display:
    """Shows the progress of a run: a bar on a terminal, else a line a minute, and a line for each reason of failure.

    The latest measurement is below the bar or at the end of the line; the first line comes with the first result. The
    numbers count cells of the plan, as `codecbench status` does; the bar grows with the work.
    """

    def __init__(self, console: Screen, keep_going: bool) -> None:
        self._keep_going = keep_going
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"))
        self._bar = _Bar(*columns, console=console, transient=True)
        self._task = self._bar.add_task("starting", total=None, note="")
        self._reasons: Counter[str] = Counter()
        self._first: dict[str, str] = {}
        self._line, self._ended = "starting", threading.Event()
        lines = not console.is_terminal and not console.quiet
        self._lines = threading.Thread(target=self._print_every_minute, daemon=True) if lines else None

    def __enter__(self) -> Display:
        if self._lines is not None:
            self._lines.start()  # and no bar, which would leave an empty line
        else:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        if self._lines is None:
            self._bar.stop()
        for reason, count in self._reasons.items():
            if count > 1:
                cells = "1 more cell has" if count == 2 else f"{count - 1} more cells have"
                click.echo(f"{cells} no result for the same reason as {self._first[reason]}", err=True)

    def show(self, progress: Progress) -> None:
        """Show the progress. Raises ClickException if a cell failed and the run is to stop at the first failure."""
        first = progress.measured and not self._bar.measured
        self._bar.measured = clean_line(progress.measured) or self._bar.measured
        summary = describe_progress(progress)
        self._line = "; ".join(filter(None, (summary, self._bar.measured)))
        if first and self._lines is not None:
            say(self._line, err=True)
        count, _, note = summary.partition(", ")
        share = progress.share
        done, total = (0.0, None) if share is None else (share, 1.0)
        self._bar.update(self._task, description=count, completed=done, total=total, note=note)
        if progress.notice:
            click.secho(clean_line(progress.notice), fg="yellow", err=True)
        record, cell = progress.record, progress.cell
        if record is None or cell is None or record.status in ("ok", "unsupported"):
            return
        codec = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
        name = f"{cell.sequence.name} | {codec} | {cell.evaluator.name} #{cell.repeat}"
        self._reasons[record.reason] += 1
        if self._reasons[record.reason] == 1:
            self._first[record.reason] = clean_line(name)
            click.echo(clean_line(f"{record.status}: {name}: {record.reason}"), err=True)
        if not self._keep_going:
            raise click.ClickException("stopped at the first failure (--fail-fast); finished cells are kept")

    def _print_every_minute(self) -> None:
        while not self._ended.wait(_LINE_EVERY_S):
            with suppress(OSError):
                say(self._line, err=True)


def describe_progress(progress: Progress) -> str:
    """Return the progress in words, such as `12 of 90 cells, about 3:20 left`."""
    done = progress.cells_done + progress.cells_kept
    parts = [
        f"{done} of {progress.cells_total} cells",
        progress.compiling,
        "" if progress.remaining_s is None else f"about {format_clock(progress.remaining_s)} left",
        f"{progress.not_ok} without a result" if progress.not_ok else "",
    ]
    return ", ".join(filter(None, parts))


def format_clock(seconds: float) -> str:
    """Format a time as `m:ss`, or `h:mm:ss` from an hour."""
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes}:{seconds:02d}" if minutes < 60 else f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
