"""`codecbench table`."""

from __future__ import annotations

from pathlib import Path

import click

from codecbench.cli import show
from codecbench.cli.formats import Format
from codecbench.cli.rank import show_verdicts
from codecbench.cli.saying import say
from codecbench.core.analysis import collect
from codecbench.core.analysis import table as analysis_table
from codecbench.core.engine.storage import atomic
from codecbench.core.engine.text import counted
from codecbench.core.report import choosing as choosing_tables
from codecbench.core.report import tables

FORMATS = ("text", "csv", "parquet", "json", "markdown", "latex")


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--wide", "shape", flag_value="wide", default=True, help="One row a sequence and codec setting (default)."
)
@click.option("--tidy", "shape", flag_value="tidy", help="One row a measurement.")
@click.option("--all", "every", is_flag=True, help="All columns, and not only the headlines.")
@click.option("--format", "format_", type=Format(FORMATS), default="text", show_default=True)
@click.option("--columns", help="Only these columns of the wide table, separated by commas; `*` matches anything.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write to this file instead of printing.")
def table(run: Path, shape: str, every: bool, format_: str, columns: str | None, out: Path | None) -> None:
    """Print or write a table of the RUN folder: for people its headlines, for programs everything."""

    result = collect.open_nonempty_run(run)
    frame, same = result.wide if shape == "wide" else result.tidy, ""
    headlines = shape == "wide" and columns is None and not every
    if columns is not None:
        frame = tables.chosen_columns(frame, columns)
    if format_ == "text":
        if out is not None:
            raise click.UsageError("--out needs a --format other than text")
        if headlines:
            show.show_summary(result)
            show_verdicts(choosing_tables.over_links(result)[-1:])
            show.show_reasons(result)
            said = f"{len(frame.columns)} columns in all: --all or --columns shows them, --format csv writes them"
            say(said)
            return
        whole = [name for name in frame.columns if columns is not None or "/" not in name]
        show.show_table(frame[whole], result.plan.name)
        if left_out := len(frame.columns) - len(whole):
            said = f"{counted(left_out, 'column')} of single stages left out here; --columns '*/*' shows them"
            say(said)
        return
    if headlines and format_ in ("markdown", "latex"):
        frame, same = tables.varying(tables.short_table(result).join(result.wide.filter([analysis_table.NOTES])))
    content = tables.exported(frame, format_, same)
    if out is not None:
        atomic.write_file(out, content)
        click.echo(str(out))
    elif format_ == "parquet":
        raise click.UsageError("--format parquet is not text; name a file with --out")
    else:
        click.echo(content.decode(), nl=False)
