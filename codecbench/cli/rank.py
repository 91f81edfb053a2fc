"""`codecbench rank`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from codecbench.cli import display, show
from codecbench.cli.messages import say
from codecbench.cli.parameters import Format
from codecbench.core.analysis import collect
from codecbench.core.report import answers, formatting, picks, tables

if TYPE_CHECKING:
    from codecbench.core.analysis.run_result import RunResult
    from codecbench.core.report.formatting import Verdict

FORMATS: Final = ("text", "markdown", "latex", "json")
_NOTES: Final = 4
"""How many lines of notes are printed without --all."""

everything_option = click.option("--all", "everything", is_flag=True, help="Also print the details behind the answer.")


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--format", "format_", type=Format(FORMATS), default="text", show_default=True)
@everything_option
@click.option(
    "--rate",
    "rates",
    type=click.FloatRange(min=0, min_open=True),
    multiple=True,
    help="Recommend a codec and setting at this rate, in the unit of the tables (bit/px); repeatable.",
)
def rank(run: Path, format_: str, everything: bool, rates: tuple[float, ...]) -> None:
    """Recommend a codec of the RUN folder: print the pick of each codec, and the answer.

    With --all, also print which codecs are ahead by each task on each sequence, what is inconclusive and what would
    decide it, and the lowest rate at which each codec passes. JSON always includes all of it.
    """
    result = collect.open_nonempty_run(run)
    if rates:
        print_in_format(
            result, [verdict for rate in rates for verdict in formatting.verdicts_at(result, rate)], format_
        )
        return
    details = formatting.verdicts(result) if everything or format_ == "json" else []
    print_in_format(result, [*details, *picks.answer_tables(result)], format_, everything=everything)


def show_answer(result: RunResult) -> None:
    """Print the pick of each codec, and the answer last."""
    _show_tables_and_answer(picks.answer_tables(result))


def _show_tables_and_answer(verdicts: list[Verdict]) -> None:
    show_verdicts(verdicts[:-1])
    for sentence in verdicts[-1].sentences:
        say(sentence)


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--power", type=click.FloatRange(0.05, 0.999), default=0.8, show_default=True, help="Probability of detection."
)
@click.option("--format", "format_", type=Format(FORMATS), default="text", show_default=True)
def power(run: Path, power: float, format_: str) -> None:
    """Show which differences the RUN folder can detect, which are significant, and what would decide the others.

    For each pair of codecs: the smallest difference that is detected with probability POWER, at the level of
    `codecbench rank`; and what would decide: settings, up to a hundredfold of frames, sequences, or nothing. For each
    setting that can fail: the lowest success rate at which as many runs would show that it passes.
    """
    result = collect.open_nonempty_run(run)
    print_in_format(result, formatting.power_verdicts(result, power), format_)


def show_everything(result: RunResult) -> None:
    """Print what the answer rests on, over all sequences: verdicts, a sentence for each codec, the primary metrics."""
    show_verdicts(formatting.verdicts(result, brief=True))
    for answer in answers.answers_of_settings(result):
        for line in (*answer.lines, ""):
            say(line)
    show.show_table(tables.short_table(result, brief=True), result.plan.name)


def print_in_format(result: RunResult, verdicts: list[Verdict], format_: str, *, everything: bool = True) -> None:
    """Print verdicts on a run in a format, with notes on its settings; as text the answer comes last."""
    notes = [*tables.calibration_notes(result), *tables.setting_notes(result)]
    if format_ == "json":
        names = [None if verdict.about is None else verdict.about.name for verdict in verdicts]
        rows = [{**vars(verdict), "about": name} for verdict, name in zip(verdicts, names, strict=True)]
        click.echo(json.dumps(rows, indent=1))
    elif format_ == "text":
        has_answer = bool(verdicts) and verdicts[-1].title == "answer"
        if not verdicts:
            say("nothing to rank: this needs a rate, and a primary metric of role task, quality or success; "
                "with --rate, two codecs whose settings reach it")  # fmt: skip
        if not has_answer:
            show_verdicts(verdicts)
        show_notes(notes, everything)
        if has_answer:
            _show_tables_and_answer(verdicts)
    else:
        click.echo(picks.text_to_paste(result, verdicts, format_), nl=False)
    if result.missing:
        say(f"{result.missing} cells of the plan have no record yet", err=True)


def show_notes(notes: list[str], everything: bool) -> None:
    """Print notes: the first ones, and how many more there are."""
    shown = notes if everything or len(notes) <= _NOTES else notes[: _NOTES - 1]
    for note in shown:
        say(note, fg="yellow")
    if more := len(notes) - len(shown):
        say(f"{more} more notes: --all shows them", fg="yellow")


def show_verdicts(verdicts: list[Verdict]) -> None:
    """Print verdicts in the terminal."""
    for verdict in verdicts:
        say(verdict.title, bold=True)
        if verdict.rows:
            display.plain_table(verdict.heads, verdict.rows)
        for sentence in verdict.sentences:
            say(sentence)
        click.echo()
