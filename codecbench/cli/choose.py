"""`codecbench choose`."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from codecbench.cli import display
from codecbench.cli.parameters import Format
from codecbench.cli.rank import FORMATS, everything_option, print_in_format
from codecbench.cli.run import exit_with_status, show_cells
from codecbench.core.analysis import choosing, collect
from codecbench.core.engine.plugins import registry
from codecbench.core.report import choosing as choosing_tables
from codecbench.core.rounds import running
from codecbench.trial import choosing as trial_choosing

if TYPE_CHECKING:
    from codecbench.core.analysis.choosing import Demand
    from codecbench.core.analysis.run_result import RunResult


def quantity(units: Mapping[str, float]) -> Callable[[str], float]:
    """Return a reader of a number with a unit, in the first of `units`: `5cm` is 0.05 if that is the meter."""

    def quantity(text: str) -> float:
        match = re.fullmatch(r"(\d+\.?\d*|\.\d+)\s*([a-z]+)", text)
        if match is None or match[2] not in units or float(match[1]) <= 0:
            raise click.BadParameter(f"{text!r} is not a positive number with one of {', '.join(units)}")
        return float(match[1]) * units[match[2]]

    return quantity


@click.command()
@click.argument("source", metavar="RUN|MATRIX", type=click.Path(path_type=Path))
@click.option("--link", metavar="LINK", help="Link that sends the frames; for a RUN, default: each of its links.")
@click.option("--deadline", type=quantity({"ms": 1.0, "s": 1000.0}), metavar="TIME",
              help="Maximum age of a frame on delivery, such as 100ms.")  # fmt: skip
@click.option("--error", type=quantity({"m": 1.0, "cm": 0.01, "mm": 0.001}), metavar="LENGTH",
              help="Maximum error of the task that reads the frames, such as 5cm.")  # fmt: skip
@click.option("--share", type=click.FloatRange(0, 1, min_open=True), default=0.95, show_default=True,
              help="Minimum fraction of frames delivered before the deadline.")  # fmt: skip
@click.option("--device-factor", type=click.FloatRange(min=0, min_open=True), metavar="FACTOR",
              help="Include the encoding time, on a device FACTOR times slower than the timed one.")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False),
              help="For a matrix: run folder; default runs/NAME.")  # fmt: skip
@click.option("--workers", type=click.IntRange(1), help="For a matrix: worker processes.")
@click.option("--minutes", type=click.FloatRange(min=0), show_default="10",
              help="For a matrix: start additional repeats only within this time.")  # fmt: skip
@click.option("--format", "format_", type=Format(FORMATS), default="text", show_default=True)
@everything_option
def choose(
    source: Path,
    link: str | None,
    deadline: float | None,
    error: float | None,
    share: float,
    device_factor: float | None,
    out: Path | None,
    workers: int | None,
    minutes: float | None,
    format_: str,
    everything: bool,
) -> None:
    """Show which settings of a RUN folder are good enough over a link, and what limits the others.

    Given a MATRIX, first run what the answer needs, in its run folder, and continue where an earlier run stopped. This
    adds missing evaluators of the link, and repeats until they decide. A MATRIX needs --link, and --deadline or
    --error.

    Settings are in order of rate; use the first that passes. A run over the link succeeds if the task has a fresh pose
    at half of the capture times or more, its error is at most --error and lower than with nothing received, and enough
    frames meet the deadline. A setting passes if the 95 % confidence interval of its success rate lies above 50 %.
    """
    if trial_choosing.is_matrix(source):
        if link is None:
            raise click.UsageError("--link is missing: give one such as wifi_edge; `codecbench list links` lists all")
        if deadline is None and error is None:
            raise click.UsageError("give --deadline, --error or both")
        demand = choosing.Demand(link, deadline, error, share, device_factor)
        _run_and_choose(
            source, demand, out, workers, trial_choosing.MINUTES if minutes is None else minutes, format_, everything
        )
        return
    matrix_options = {"--out": out, "--workers": workers, "--minutes": minutes}
    if names := [name for name, value in matrix_options.items() if value is not None]:
        raise click.UsageError(f"{names[0]} needs a matrix, and {source} is not one")
    if device_factor is not None and deadline is None and error is None:
        raise click.UsageError("--device-factor increases the age of frames; give a --deadline too")
    _show(
        collect.open_nonempty_run(source),
        choosing.Demand(link or "", deadline, error, share, device_factor),
        format_,
        everything,
    )


def _show(run: RunResult, demand: Demand, format_: str, everything: bool) -> None:
    """Print the pick of each codec and the answers, and every setting if asked."""
    *tables, answer = choosing_tables.choices(run, demand)
    details = tables if everything or format_ == "json" else []
    print_in_format(run, [*details, *choosing_tables.link_picks(run, demand), answer], format_, everything=everything)


def _run_and_choose(
    matrix: Path,
    demand: Demand,
    out: Path | None,
    workers: int | None,
    minutes: float,
    format_: str,
    everything: bool,
) -> None:
    """Run what the choice needs, with progress on standard error, print it, and exit with the status of the run."""
    link_matrix = trial_choosing.link_matrix(matrix, demand, registry.installed())
    for line in link_matrix.added:
        click.echo(line, err=True)
    with display.Display(display.Screen(stderr=True), True) as progress:
        summary = running.run_matrix(link_matrix.matrix, out, workers=workers, listener=progress.show, minutes=minutes)
    show_cells(summary, err=True)
    if not summary.interrupted and "ok" in summary.statuses:
        _show(collect.open_nonempty_run(summary.folder), link_matrix.demand, format_, everything)
    exit_with_status(summary)
