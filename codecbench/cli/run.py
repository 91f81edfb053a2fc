"""`codecbench run`."""

from __future__ import annotations

import logging
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from codecbench.cli import display
from codecbench.cli.messages import ExitStatus
from codecbench.cli.parameters import plugin_names
from codecbench.cli.rank import everything_option, show_answer, show_everything, show_notes
from codecbench.core.analysis import collect
from codecbench.core.engine.planning import matrix as matrix_file
from codecbench.core.engine.plugins import registry
from codecbench.core.engine.storage import store as run_store
from codecbench.core.engine.text import clean_line, counted
from codecbench.core.report import page as report_page
from codecbench.core.report import tables
from codecbench.core.rounds import running

if TYPE_CHECKING:
    from codecbench.core.analysis.run_result import RunResult
    from codecbench.core.engine.planning.matrix import Matrix
    from codecbench.core.engine.running.progress import RunSummary

LEVELS = ("debug", "info", "warning", "error")


@click.command()
@click.argument("matrix", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="The run folder; default runs/NAME.")
@click.option("--workers", type=click.IntRange(1), help="Worker processes; default: as in the matrix.")
@click.option(
    "--recompute",
    multiple=True,
    metavar="NAME",
    shell_complete=plugin_names,
    help="Compute all cells of a codec, evaluator or sequence again.",
)
@click.option("--keep-going/--fail-fast", default=True, show_default=True, help="Continue after a cell fails.")
@click.option("--log-level", type=click.Choice(LEVELS), default="info", show_default=True, help="Log level of run.log.")
@everything_option
@click.option("--quiet", is_flag=True, help="Print only failures and the run folder.")
def run(
    matrix: Path,
    out: Path | None,
    workers: int | None,
    recompute: tuple[str, ...],
    keep_going: bool,
    log_level: str,
    everything: bool,
    quiet: bool,
) -> None:
    """Run a MATRIX: every codec setting on every sequence, evaluated.

    Continue where an earlier run in the same folder stopped. The exit status is 1 if a cell failed or none has a
    result, and 130 if the run was stopped.
    """
    for problem in registry.installed().problems:
        click.secho(f"left out: {clean_line(str(problem))}", fg="yellow", err=True)
    parsed = matrix_file.read_matrix(matrix)
    with display.Display(display.Screen(stderr=True, quiet=quiet), keep_going) as progress:
        summary = running.run_matrix(
            parsed,
            out,
            workers=workers,
            recompute=recompute,
            listener=progress.show,
            log_level=logging.getLevelName(log_level.upper()),
        )
    result = _show(summary, quiet, everything)
    if "ok" in summary.statuses:
        page = summary.folder / "report" / "report.html"
        click.echo(f"report: `codecbench report {summary.folder}` writes {page}")
        if result is not None:
            show_answer(result)
    exit_with_status(summary)


def run_and_report(
    matrix: Matrix, out: Path | None, *, workers: int | None, show: bool, minutes: float, everything: bool
) -> None:
    """Run a matrix, write its report and print where it is; with `show` open it in a browser.

    everything: print all that the answer rests on. minutes: searches try nothing that would end later, and name what
    they did not try.
    """
    with display.Display(display.Screen(stderr=True), True) as progress:
        summary = running.run_matrix(matrix, out, workers=workers, listener=progress.show, minutes=minutes)
    result = _show(summary, False, everything)
    click.echo(f"the matrix: {summary.folder / 'matrix.yaml'}")
    if result is not None and "ok" in summary.statuses:
        page = (summary.folder / "report" / "report.html").absolute()
        report_page.write_report(result, page, "html")
        click.echo(f"the report: {page.as_uri()}")
        show_answer(result)
        if show:
            click.launch(page.as_uri())
    exit_with_status(summary)


def _show(summary: RunSummary, quiet: bool, everything: bool) -> RunResult | None:
    """Print, if asked, all that the run decides, then its notes and what became of its cells."""
    result = None
    if not quiet and summary.statuses and not (summary.interrupted and "ok" not in summary.statuses):
        result = collect.open_run(summary.folder)
        if everything:
            show_everything(result)
        stopped = [f"{search.codec}: {search.words}." for search in result.plan.searches if search.state == "stopped"]
        show_notes([*stopped, *tables.notes(result)], everything)
    show_cells(summary)
    return result


def show_cells(summary: RunSummary, *, err: bool = False) -> None:
    """Print what became of the cells of a run, and its folder. err: print all of it on standard error."""
    counts = ", ".join(f"{count} {status}" for status, count in sorted(summary.statuses.items()))
    kept_cells = f", {summary.kept} of them from an earlier run" if summary.kept else ""
    click.echo(f"cells: {counts or 'none'}{kept_cells}", err=err)
    for reason, count in Counter(_unsupported_reasons(summary)).items():
        click.echo(f"unsupported ({count}): {reason}", err=True)
    click.echo(f"run folder: {summary.folder}", err=err)
    if summary.damaged:
        click.echo(f"damaged and computed again: {counted(len(summary.damaged), 'cell')}; reasons in run.log", err=True)


def _unsupported_reasons(summary: RunSummary) -> list[str]:
    """Return why cells of the plan cannot be computed here, cell by cell."""
    if "unsupported" not in summary.statuses:
        return []

    store = run_store.Store(summary.folder)
    entries = store.entries()
    recorded = (entries[cell.id] for cell in store.read_plan().cells if cell.id in entries)
    return [entry.reason for entry in recorded if entry.status == "unsupported"]


def exit_with_status(summary: RunSummary) -> None:
    """End the command with the exit status that fits the run."""
    if summary.interrupted:
        before = "" if "ok" in summary.statuses else " before a cell had a result"
        click.echo(f"stopped by {summary.interrupted}{before}; the same command continues from here", err=True)
        raise click.exceptions.Exit(ExitStatus.INTERRUPTED)
    if "ok" not in summary.statuses:
        cause = "here every cell is unsupported" if set(summary.statuses) == {"unsupported"} else "no cell has a result"
        click.echo(f"Error: {cause}; the reasons are above, or in `codecbench status --failed`", err=True)
        raise click.exceptions.Exit(ExitStatus.FOUND)
    if any(count for status, count in summary.statuses.items() if status not in ("ok", "unsupported")):
        raise click.exceptions.Exit(ExitStatus.FOUND)
