"""How far a run is, on a terminal and without one."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from typing import Final

import click
from rich.console import RenderableType
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as ProgressBar
from rich.text import Text

from codecbench.cli.saying import say
from codecbench.cli.screen import Screen
from codecbench.core.engine.running.progress import Progress
from codecbench.core.engine.text import clean_line

_LINE_EVERY_S: Final = 60.0


class _Bar(ProgressBar):
    """A bar, and below it what was measured last."""

    measured = ""

    def get_renderables(self) -> Iterable[RenderableType]:
        yield self.make_tasks_table(self.tasks)
        yield Text(self.measured, style="dim", no_wrap=True, overflow="ellipsis")


class Display:
    """A bar, or a line a minute where there is no terminal, and one line for every reason of which a cell fails.

    What was measured last stands below the bar or ends the line, and the first line comes with the first result.
    What is counted are the cells of the plan, as `codecbench status` does; the bar grows with the work.
    """

    def __init__(self, console: Screen, keep_going: bool) -> None:
        self._keep_going = keep_going
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"))
        self._bar = _Bar(*columns, console=console, transient=True)
        self._task = self._bar.add_task("starting", total=None, note="")
        self._reasons: Counter[str] = Counter()
        self._first: dict[str, str] = {}
        self._said, self._ended = "starting", threading.Event()
        lines = not console.is_terminal and not console.quiet
        self._lines = threading.Thread(target=self._say_every_minute, daemon=True) if lines else None

    def __enter__(self) -> Display:
        self._bar.start()
        if self._lines is not None:
            self._lines.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._bar.stop()
        for reason, count in self._reasons.items():
            if count > 1:
                cells = "1 more cell has" if count == 2 else f"{count - 1} more cells have"
                click.echo(f"{cells} no result for the reason of {self._first[reason]}", err=True)

    def show(self, progress: Progress) -> None:
        """Take in how far the run is. Raises ClickException where a cell failed and the run is to end then."""

        first = progress.measured and not self._bar.measured
        self._bar.measured = clean_line(progress.measured) or self._bar.measured
        words = spoken(progress)
        self._said = "; ".join(filter(None, (words, self._bar.measured)))
        if first and self._lines is not None:
            say(self._said, err=True)
        count, _, note = words.partition(", ")
        share = progress.share
        done, total = (0.0, None) if share is None else (share, 1.0)
        self._bar.update(self._task, description=count, completed=done, total=total, note=note)
        if progress.notice:
            click.secho(clean_line(progress.notice), fg="yellow", err=True)
        record, cell = progress.record, progress.cell
        if record is None or cell is None or record.status in ("ok", "unsupported"):
            return
        what = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
        name = f"{cell.sequence.name} | {what} | {cell.evaluator.name} #{cell.repeat}"
        self._reasons[record.reason] += 1
        if self._reasons[record.reason] == 1:
            self._first[record.reason] = clean_line(name)
            click.echo(clean_line(f"{record.status}: {name}: {record.reason}"), err=True)
        if not self._keep_going:
            raise click.ClickException("stopped at the first failure (--fail-fast); what is finished is kept")

    def _say_every_minute(self) -> None:
        while not self._ended.wait(_LINE_EVERY_S):
            with suppress(OSError):
                say(self._said, err=True)


def spoken(progress: Progress) -> str:
    """A moment of a run in words, such as `12 of 90 cells, about 3:20 left`."""
    done = progress.cells_done + progress.cells_kept
    parts = [
        f"{done} of {progress.cells_total} cells",
        progress.compiling,
        "" if progress.remaining_s is None else f"about {clock(progress.remaining_s)} left",
        f"{progress.not_ok} without a result" if progress.not_ok else "",
    ]
    return ", ".join(filter(None, parts))


def clock(seconds: float) -> str:
    """A time as `m:ss`, or `h:mm:ss` from an hour."""
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes}:{seconds:02d}" if minutes < 60 else f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
