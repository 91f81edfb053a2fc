"""`codecbench compare`."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from codecbench.cli import display
from codecbench.cli.messages import ExitStatus, say
from codecbench.cli.parameters import Format
from codecbench.core.analysis import comparison
from codecbench.core.analysis import table as analysis_table
from codecbench.core.report import formatting, tables

if TYPE_CHECKING:
    from codecbench.core.analysis.comparison import Comparison

_HEADS = ("sequence", "codec", "setting", "evaluator", "metric", "before", "after", "change", "verdict", "note")
_MOST_ROWS: Final = 20
_LONG_NAME: Final = 24
_BY_INTEREST: Final = ("worse", "changed", "better", "inconclusive", "same")
"""Verdicts in the order in which readers look for them."""
_FAILING = {
    "worse": {"worse"},
    "changed": {"worse", "better", "changed"},
    "inconclusive": {"worse", "inconclusive"},
    "never": set[str](),
}


@click.command()
@click.argument("before", type=click.Path(path_type=Path))
@click.argument("after", type=click.Path(path_type=Path), required=False)
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="PATTERN",
    help="Compare only these metrics: 'quality.psnr*'. Repeatable.",
)
@click.option(
    "--fail-on",
    type=click.Choice(list(_FAILING)),
    default="worse",
    show_default=True,
    help="Which verdicts make the exit status 1.",
)
@click.option(
    "--time-tolerance",
    type=float,
    default=0.05,
    show_default=True,
    help="Relative change up to which a time counts as unchanged.",
)
@click.option("--format", "format_", type=Format(["text", "markdown", "json"]), default="text", show_default=True)
@click.option("--all", "everything", is_flag=True, help="Show all rows, including unchanged ones.")
@click.option(
    "--save", type=click.Path(path_type=Path, dir_okay=False), help="Save BEFORE as a baseline file and stop."
)
def compare(
    before: Path, after: Path | None, metrics: tuple[str, ...], fail_on: str, time_tolerance: float, format_: str,
    everything: bool, save: Path | None,
) -> None:  # fmt: skip
    """Compare two runs cell by cell: run folders, or baseline files that --save wrote.

    Sizes, quality and counts are compared exactly. Times are compared statistically over repeats (at least five), in
    units of a fixed workload that was timed with them. Wall time counts as changed only if processor time agrees; a
    change of less than 10 microseconds per frame counts as none. Between different machines the verdict on times is
    “inconclusive”, with a warning. The exit status is 1 also if the runs have nothing in common.
    """
    first = comparison.read_snapshot(before)
    if save is not None:
        comparison.write_snapshot(first, save)
        click.echo(f"{save}: {len(first.series):,} series of {first.name}")
        return
    if after is None:
        raise click.UsageError("give a second run to compare with, or --save FILE to write a baseline")
    second = comparison.read_snapshot(after)
    if set(first.machines) != set(second.machines):
        machines = " | ".join("; ".join(snapshot.machines) for snapshot in (first, second))
        warning = f"warning: the runs are from different machines ({machines}); changes of times cannot be judged"
        say(warning, err=True)
    comparisons = comparison.compare(first, second, metrics=metrics, time_tolerance=time_tolerance)
    unequal = any(row.verdict in _FAILING[fail_on] for row in comparisons)
    common = {series.key for series in first.series} & {series.key for series in second.series}
    nothing = not any(row.key in common for row in comparisons)
    _print(comparisons, format_, everything, nothing)
    if comparisons and nothing:
        say("the runs have nothing in common: no sequence with the same setting, evaluator and metric", err=True)
    if unequal or (nothing and fail_on != "never"):
        raise click.exceptions.Exit(ExitStatus.FOUND)


def _print(comparisons: list[Comparison], format_: str, everything: bool, nothing: bool) -> None:
    """Print the comparisons. nothing: the runs have nothing in common, so that no row is shown unless asked for."""
    rows = [row for row in comparisons if everything or row.verdict != "same"]
    counts = Counter(row.verdict for row in comparisons)
    verdicts = ", ".join(f"{count:,} {verdict}" for verdict, count in counts.most_common()) or "nothing to compare"
    if format_ == "json":
        values = [dict(zip(_HEADS, map(analysis_table.json_value, _cells(row)), strict=True)) for row in rows]
        click.echo(json.dumps({"counts": counts, "rows": values}, indent=1))
        return
    if format_ == "markdown":
        if rows:
            click.echo(tables.foreign_table(_HEADS, map(_cells, rows)))
    elif rows and (everything or not nothing):
        _show(rows, everything)
    click.echo(f"same: all {len(comparisons):,} series" if counts.keys() == {"same"} else verdicts)


def _show(rows: list[Comparison], everything: bool) -> None:
    """Print rows as a table in the terminal: all, or the most interesting ones."""
    if not everything:
        # A series that got or lost its result has no change in numbers, and comes first.
        sizes = {id(row): math.inf if math.isnan(row.relative) else abs(row.relative) for row in rows}
        rows = sorted(rows, key=lambda row: (_BY_INTEREST.index(row.verdict), -sizes[id(row)]))
    most = len(rows) if everything else _MOST_ROWS
    cells = [
        {
            "verdict": row.verdict,
            "sequence": row.key[0],
            "setting": " ".join(row.key[1:3]).rstrip(),
            "metric": _metric(row),
            "before": tables.format_value(row.before),
            "after": tables.format_value(row.after),
            "change %": tables.format_value(100.0 * row.relative),
            "note": row.note,
        }
        for row in rows[:most]
    ]
    table = formatting.compact_table("", cells)
    display.plain_table(table.heads, table.rows)
    for sentence in table.sentences:
        say(sentence)
    if len(rows) > most:
        click.echo(f"... and {len(rows) - most:,} more; --all shows them")


def _metric(row: Comparison) -> str:
    """Return the name as --metric takes it, such as `quality.psnr_gray_db`, on two lines if it is long."""
    name = ".".join(row.key[3:])
    return name if len(name) <= _LONG_NAME else name.replace(".", ".\n", 1)


def _cells(row: Comparison) -> list[object]:
    return [*row.key, row.before, row.after, row.change, row.verdict, row.note]
