"""`codecbench run`."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn
from rich.progress import Progress as ProgressBar

from codecbench.cli.exit_status import ExitStatus
from codecbench.cli.screen import Screen

if TYPE_CHECKING:
    from codecbench.core.engine.running.progress import Progress
    from codecbench.core.engine.running.summary import RunSummary

LEVELS = ("debug", "info", "warning", "error")


@click.command()
@click.argument("matrix", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="The run folder; default runs/NAME.")
@click.option("--workers", type=click.IntRange(1), help="Worker processes; by default as many as the matrix says.")
@click.option(
    "--recompute", multiple=True, metavar="NAME", help="Compute all cells of a codec, evaluator or sequence again."
)
@click.option("--keep-going/--fail-fast", default=True, show_default=True, help="Continue after a cell fails.")
@click.option("--log-level", type=click.Choice(LEVELS), default="info", show_default=True, help="For run.log.")
@click.option("--quiet", is_flag=True, help="Print only what failed, and the run folder.")
def run(
    matrix: Path,
    out: Path | None,
    workers: int | None,
    recompute: tuple[str, ...],
    keep_going: bool,
    log_level: str,
    quiet: bool,
) -> None:
    """Run a MATRIX: every codec setting on every sequence, evaluated.

    Continues where an earlier run in the same folder stopped. The exit status is 1 if a cell failed or none has a
    result, and 130 if the run was stopped.
    """
    from codecbench.core.engine.foreign_text import clean_line
    from codecbench.core.engine.planning.matrix import read_matrix
    from codecbench.core.engine.registry import installed
    from codecbench.core.results.running import run_matrix

    for problem in installed().problems:
        click.secho(f"left out: {clean_line(str(problem))}", fg="yellow", err=True)
    read = read_matrix(matrix)
    console = Screen(stderr=True, quiet=quiet)
    with _Display(console, keep_going) as display:
        summary = run_matrix(
            read,
            out,
            workers=workers,
            recompute=recompute,
            listener=display.show,
            log_level=logging.getLevelName(log_level.upper()),
        )
    _report(summary, quiet)


class _Display:
    """The bar, and one line for every cell that fails."""

    def __init__(self, console: Screen, keep_going: bool) -> None:
        self._keep_going = keep_going
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}"),
        )
        self._bar = ProgressBar(*columns, console=console, transient=True)
        self._task = self._bar.add_task("starting", total=None, note="")

    def __enter__(self) -> _Display:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def show(self, progress: Progress) -> None:
        done = progress.cells_done + progress.cells_kept + progress.jobs_done
        total = progress.cells_total + progress.jobs_total
        left = "" if progress.remaining_s is None else f"{_clock(progress.remaining_s)} left"
        failed = f"{progress.not_ok} without a result" if progress.not_ok else ""
        note = ", ".join(filter(None, (left, failed)))
        self._bar.update(self._task, description=progress.compiling or "cells", completed=done, total=total, note=note)
        from codecbench.core.engine.foreign_text import clean_line

        if progress.notice:
            click.secho(clean_line(progress.notice), fg="yellow", err=True)
        record, cell = progress.record, progress.cell
        if record is None or cell is None or record.status in ("ok", "unsupported"):
            return
        what = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
        line = f"{record.status}: {cell.sequence.name} | {what} | {cell.evaluator.name} #{cell.repeat}: {record.reason}"
        click.echo(clean_line(line), err=True)
        if not self._keep_going:
            raise click.ClickException("stopped at the first failure (--fail-fast); what is finished is kept")


def _report(summary: RunSummary, quiet: bool) -> None:
    if not quiet and summary.statuses:
        from codecbench.cli.rank import show_verdicts
        from codecbench.cli.show import show_summary
        from codecbench.core.results.collect import open_run
        from codecbench.core.results.ranking.words import verdicts

        result = open_run(summary.folder)
        show_verdicts(verdicts(result, brief=True))
        show_summary(result)
    counts = ", ".join(f"{count} {status}" for status, count in sorted(summary.statuses.items()))
    kept = f", {summary.kept} of them from before" if summary.kept else ""
    click.echo(f"cells: {counts or 'none'}{kept}")
    click.echo(f"run folder: {summary.folder}")
    if summary.damaged:
        click.echo(f"damaged and computed again: {len(summary.damaged)} cells; run.log says why", err=True)
    if summary.interrupted:
        click.echo(f"stopped by {summary.interrupted}; the same command continues from here", err=True)
        raise click.exceptions.Exit(ExitStatus.INTERRUPTED)
    if "ok" not in summary.statuses:
        click.echo("no cell has a result; the reasons are above, or in `codecbench status --failed`", err=True)
        raise click.exceptions.Exit(ExitStatus.FOUND)
    if any(count for status, count in summary.statuses.items() if status not in ("ok", "unsupported")):
        raise click.exceptions.Exit(ExitStatus.FOUND)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes}:{seconds:02d}" if minutes < 60 else f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
