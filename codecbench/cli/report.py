"""`codecbench report` and `codecbench plot`."""

from __future__ import annotations

from pathlib import Path

import click

from codecbench.cli.formats import Format
from codecbench.core.analysis import collect
from codecbench.core.report import figures
from codecbench.core.report import page as report_page


def _numbers(_context: click.Context, _option: click.Parameter, text: str | None) -> list[int]:
    numbers = text.split(",") if text is not None else []
    if not all(number.strip().isdecimal() for number in numbers):
        raise click.BadParameter(f"{text!r} is not a list of frame numbers such as 0,57,212")
    return [int(number) for number in numbers]


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Default: RUN/report/report.html.")
@click.option("--format", "format_", type=Format(["html", "markdown", "latex"]), default="html", show_default=True)
@click.option(
    "--sequences-from",
    metavar="FOLDER|same",
    help="Show frames of a run that was made elsewhere, from sequences in FOLDER, or from the same places as there.",
)
@click.option("--frames", metavar="N,N,...", callback=_numbers, help="Show these frames, from 0, and not a few of all.")
def report(run: Path, out: Path | None, format_: str, sequences_from: str | None, frames: list[int]) -> None:
    """Write a report of the RUN folder: one HTML page that needs no network, or its tables as Markdown or LaTeX."""

    suffix = {"html": "html", "markdown": "md", "latex": "tex"}[format_]
    path = out or run / "report" / f"report.{suffix}"
    size = report_page.write_report(
        collect.open_nonempty_run(run), path, format_, sequences_from=sequences_from, frames=frames
    )
    click.echo(f"{path} ({size / 1e6:.1f} MB)" if size > 1e5 else str(path))


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="A folder; default: RUN/report.")
@click.option("--format", "format_", type=click.Choice(["svg", "png", "pdf"]), default="svg", show_default=True)
def plot(run: Path, out: Path | None, format_: str) -> None:
    """Draw the figures of the RUN folder: curves over the rate, bars by stage, and maps."""

    path = None
    for path in figures.draw_all(collect.open_nonempty_run(run), out or run / "report", format_):
        click.echo(str(path))
    if path is None:
        click.echo("no figure: the run has no path, and no rate with a metric that differs between codecs")
