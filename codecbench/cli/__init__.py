"""The command line. A command's module is imported when the command is called, so that help is instant."""

from __future__ import annotations

import importlib
import os
import sys
from typing import Any, Final

import click
from click.shell_completion import CompletionItem, shell_complete

import codecbench.cli.late  # noqa: F401 - before what it loads late
from codecbench.cli.messages import close_output, report_error
from codecbench.core.engine.hosting import confinement

COMPLETION_VARIABLE: Final = "_CODECBENCH_COMPLETE"
"""The environment variable by which a shell asks for completions, as click calls it."""

COMMANDS = {
    "try": ("codecbench.cli.try_:try_", "Try codecs on your own recording, and write a report."),
    "init": ("codecbench.cli.try_:init", "Write a matrix to edit: a first one, or one for a recording."),
    "examples": ("codecbench.cli.examples:examples", "List or print the example matrices."),
    "run": ("codecbench.cli.run:run", "Run a matrix: every codec setting on every sequence, evaluated."),
    "plan": ("codecbench.cli.plan:plan", "Show what a run would do, what is cached and what is unsupported."),
    "list": ("codecbench.cli.list:list_plugins", "List installed plugins."),
    "schema": ("codecbench.cli.list:schema", "Print the JSON Schema of a matrix or of a plugin's parameters."),
    "rank": ("codecbench.cli.rank:rank", "Recommend a codec and its setting."),
    "power": ("codecbench.cli.rank:power", "Show which differences a run can detect, and what decides the others."),
    "choose": (
        "codecbench.cli.choose:choose",
        "Show which settings are good enough over a link, and what limits the others.",
    ),
    "apply": ("codecbench.cli.apply:apply", "Print configuration to paste into a robot, for the recommended setting."),
    "report": ("codecbench.cli.report:report", "Write a report: one HTML page, or Markdown or LaTeX tables."),
    "plot": ("codecbench.cli.report:plot", "Draw the figures of a run as SVG, PNG or PDF."),
    "compare": ("codecbench.cli.compare:compare", "Compare two runs: better, worse, same or inconclusive."),
    "status": ("codecbench.cli.plan:status", "Show the progress of a run, also while it is running."),
    "reproduce": ("codecbench.cli.report:reproduce", "Compare the paper's tables and figures with a run."),
    "data": ("codecbench.cli.data:data", "List, fetch and find datasets."),
    "warm-up": ("codecbench.cli.warm_up:warm_up", "Compile kernels before runs need them."),
    "bundle": ("codecbench.cli.bundle:bundle", "Pack a run into one file to archive, cite and share."),
    "open": ("codecbench.cli.bundle:open_bundle", "Unpack a bundle and report on it, without running code from it."),
    "verify-run": ("codecbench.cli.bundle:verify_run", "Recompute some cells of a bundle and compare their values."),
    "verify": ("codecbench.cli.verify:verify", "Check that codecs meet their contract; write and check corpora."),
    "export": ("codecbench.cli.export:export", "Write bitstreams or results for other programs."),
    "table": ("codecbench.cli.report:table", "Print or write the tables of a run."),
}


class LazyGroup(click.Group):
    """A group whose commands are imported when they are called, not when help is shown."""

    def list_commands(self, context: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        target, _ = COMMANDS[name]
        module, _, attribute = target.partition(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, summary) for name, (_, summary) in COMMANDS.items()])

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete names of commands without importing any."""
        names = [name for name in COMMANDS if name.startswith(incomplete)]
        options = click.Command.shell_complete(self, ctx, incomplete)
        return [*(CompletionItem(name, help=COMMANDS[name][1]) for name in names), *options]

    def resolve_command(self, context: click.Context, args: list[str]) -> Any:
        try:
            return super().resolve_command(context, args)
        except click.UsageError as error:
            import difflib  # only mistyped commands need it

            matches = difflib.get_close_matches(args[0], COMMANDS, n=1) if args else []
            hint = f" Did you mean '{matches[0]}'?" if matches else ""
            raise click.UsageError(f"{error.message}{hint}", error.ctx) from None


@click.group(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="codecbench")
@click.option("--confine", is_flag=True, help="Block other distributions' plugins from the network and your files.")
def cli(confine: bool) -> None:
    """Benchmark image codecs by their effect on the task that uses the images."""
    if confine:
        os.environ[confinement.VARIABLE] = "1"
    if confinement.is_confinement_requested():
        confinement.confinement()


def main() -> None:
    """Run the command of this process. Whatever ends it becomes a message, not a traceback, and an exit status."""
    if COMPLETION_VARIABLE in os.environ:
        sys.exit(shell_complete(cli, {}, "codecbench", COMPLETION_VARIABLE, os.environ[COMPLETION_VARIABLE]))
    status = 0
    try:
        with cli.make_context("codecbench", sys.argv[1:]) as context:
            cli.invoke(context)
        close_output()
    except click.exceptions.Exit as end:
        status = end.exit_code
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - a fault of our own is reported like any other end
        status = report_error(error)
    try:
        close_output()
    except OSError as error:
        status = status or report_error(error)
    sys.exit(status)
