"""`codecbench report`, `codecbench plot`, `codecbench table` and `codecbench reproduce`."""

from __future__ import annotations

from pathlib import Path

import click

from codecbench.cli import show
from codecbench.cli.messages import say
from codecbench.cli.parameters import Format
from codecbench.cli.rank import show_verdicts
from codecbench.core.analysis import collect
from codecbench.core.analysis import table as analysis_table
from codecbench.core.engine import text as terminal_text
from codecbench.core.engine.storage import atomic
from codecbench.core.report import choosing as choosing_tables
from codecbench.core.report import figures, tables
from codecbench.core.report import page as report_page
from codecbench.paper import page as paper_page


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
    help="Show frames of a run from another machine, from sequences in FOLDER; `same`: from the paths in its plan.",
)
@click.option(
    "--frames", metavar="N,N,...", callback=_numbers, help="Show these frames, from 0; default: a few of all."
)
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
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder; default: RUN/report.")
@click.option("--format", "format_", type=click.Choice(["svg", "png", "pdf"]), default="svg", show_default=True)
def plot(run: Path, out: Path | None, format_: str) -> None:
    """Draw the figures of the RUN folder: curves over the rate, bars by stage, and maps."""
    path = None
    for path in figures.draw_all(collect.open_nonempty_run(run), out or run / "report", format_):
        click.echo(str(path))
    if path is None:
        click.echo("no figure: the run has no trajectory, and no rate with a metric that differs between codecs")


FORMATS = ("text", "csv", "parquet", "json", "markdown", "latex")


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--wide", "shape", flag_value="wide", default=True, help="One row per sequence and codec setting (default)."
)
@click.option("--tidy", "shape", flag_value="tidy", help="One row per measurement.")
@click.option("--all", "every", is_flag=True, help="All columns, not only the primary metrics.")
@click.option("--format", "format_", type=Format(FORMATS), default="text", show_default=True)
@click.option("--columns", help="Only these columns of the wide table, separated by commas; `*` matches anything.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write to this file instead of printing.")
def table(run: Path, shape: str, every: bool, format_: str, columns: str | None, out: Path | None) -> None:
    """Print or write a table of the RUN folder: primary metrics for people, everything for programs."""
    result = collect.open_nonempty_run(run)
    frame, same = result.wide if shape == "wide" else result.tidy, ""
    headlines = shape == "wide" and columns is None and not every
    if columns is not None:
        frame = tables.select_columns(frame, columns)
    if format_ == "text":
        if out is not None:
            raise click.UsageError("--out needs a --format other than text")
        if headlines:
            show.show_summary(result)
            show_verdicts(choosing_tables.link_verdicts(result)[-1:])
            show.show_reasons(result)
            said = f"{len(frame.columns)} columns in all: --all or --columns shows them, --format csv writes them"
            say(said)
            return
        whole = [name for name in frame.columns if columns is not None or "/" not in name]
        show.show_table(frame[whole], result.plan.name)
        if left_out := len(frame.columns) - len(whole):
            count = terminal_text.counted(left_out, "column")
            say(f"{count} of single stages hidden; --columns '*/*' shows them")
        return
    if headlines and format_ in ("markdown", "latex"):
        frame, same = tables.drop_constant_columns(
            tables.short_table(result).join(result.wide.filter([analysis_table.NOTES]))
        )
    content = tables.export_table(frame, format_, same)
    if out is not None:
        atomic.write_file(out, content)
        click.echo(str(out))
    elif format_ == "parquet":
        raise click.UsageError("--format parquet needs --out FILE")
    else:
        click.echo(content.decode(), nl=False)


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=Path("paper.md"), show_default=True)
def reproduce(runs: tuple[Path, ...], out: Path) -> None:
    """Write the page that compares the paper with a run of examples/paper.yaml, table by table.

    Further runs, such as one of examples/paper_loops.yaml, add their trajectories.
    """
    for path in paper_page.write_page([collect.open_nonempty_run(run) for run in runs], out):
        click.echo(str(path))
