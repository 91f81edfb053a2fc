"""`codecbench rank`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.table import Table
from rich.text import Text

from codecbench.cli.formats import Format
from codecbench.cli.screen import Screen

if TYPE_CHECKING:
    from codecbench.core.analysis.run_result import RunResult
    from codecbench.core.report.formatting import Verdict


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--format", "format_", type=Format(["text", "markdown", "json"]), default="text", show_default=True)
@click.option(
    "--rate",
    "rates",
    type=click.FloatRange(min=0, min_open=True),
    multiple=True,
    help="Say which codec and setting to take at this rate, in the unit of tables (bit/px); repeatable.",
)
def rank(run: Path, format_: str, rates: tuple[float, ...]) -> None:
    """Say which codec of the RUN folder to take, what is undecided, and down to which rate each codec passes."""
    from codecbench.core.analysis.collect import open_nonempty_run
    from codecbench.core.report.formatting import verdicts, verdicts_at

    result = open_nonempty_run(run)
    found = [verdict for rate in rates for verdict in verdicts_at(result, rate)] if rates else verdicts(result)
    show_found(result, found, format_)
    if format_ == "text" and not rates:
        show_answer(result)


def show_answer(result: RunResult) -> None:
    """Print what to take, as the last line."""
    from codecbench.core.engine.foreign_text import clean_line
    from codecbench.core.report.answers import answers

    click.echo("\n".join(clean_line(line) for line in str(answers(result)).splitlines()))


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--power", type=click.FloatRange(0.05, 0.999), default=0.8, show_default=True, help="Share of cases that find it."
)
@click.option("--format", "format_", type=Format(["text", "markdown", "json"]), default="text", show_default=True)
def power(run: Path, power: float, format_: str) -> None:
    """Say which differences the RUN folder could show, which are significant, and what would decide the others.

    For each two codecs: the smallest difference that would have been found, at the level of `codecbench rank`, in the
    share POWER of cases; and what would decide: settings, up to a hundredfold of frames, sequences, or nothing. For
    each setting that can fail: from which success rate on so many runs would show that it passes.
    """
    from codecbench.core.analysis.collect import open_nonempty_run
    from codecbench.core.report.formatting import power_verdicts

    result = open_nonempty_run(run)
    show_found(result, power_verdicts(result, power), format_)


def show_found(result: RunResult, found: list[Verdict], format_: str) -> None:
    """The verdicts on a run in one of the formats; for people, with what is noted of its settings below."""
    from codecbench.core.report.tables import setting_notes

    if format_ == "json":
        about = [None if verdict.about is None else verdict.about.name for verdict in found]
        rows = [{**vars(verdict), "about": name} for verdict, name in zip(found, about, strict=True)]
        click.echo(json.dumps(rows, indent=1))
    elif format_ == "markdown":
        from codecbench.core.report.tables import escaped

        click.echo(markdown(found))
        for note in setting_notes(result):
            click.echo(f"- {escaped(note)}")
    else:
        show_verdicts(found)
        if not found:
            click.echo(
                "nothing to rank: it takes a rate, and a headline of role task, quality or success; "
                "with --rate, two codecs whose settings reach it"
            )
        for note in setting_notes(result):
            click.secho(note, fg="yellow")
    if result.missing:
        click.echo(f"{result.missing} cells of the plan have no record yet", err=True)


def show_verdicts(found: list[Verdict]) -> None:
    """The verdicts in the terminal."""
    console = Screen()
    if not console.is_terminal:
        console = Screen(width=120)
    for verdict in found:
        console.print(Text(verdict.title, style="bold"))
        if verdict.rows:
            table = Table(show_edge=False, header_style="dim", box=None)
            for head in verdict.heads:
                table.add_column(Text(head), overflow="fold")
            for row in verdict.rows:
                table.add_row(*(Text(cell) for cell in row))
            console.print(table)
        for sentence in verdict.sentences:
            console.print(Text(sentence))
        console.print()


def markdown(found: list[Verdict]) -> str:
    """The verdicts as Markdown."""
    from codecbench.core.report.tables import escaped, foreign_table

    parts = []
    for verdict in found:
        parts.append(f"### {escaped(verdict.title)}\n")
        if verdict.rows:
            parts.append(foreign_table(verdict.heads, verdict.rows))
        parts.append("\n".join(f"- {escaped(sentence)}" for sentence in verdict.sentences) + "\n")
    return "\n".join(parts)
