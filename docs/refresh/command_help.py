"""Print the help of every command as docs/commands.md shows it."""

from __future__ import annotations

from click import Context
from click.testing import CliRunner

from codecbench.cli import COMMANDS, cli


def main() -> None:
    for name in COMMANDS:
        group = cli.get_command(Context(cli), name)
        print(f"## {name}\n")
        for words in [[name], *([name, each] for each in getattr(group, "commands", ()))]:
            done = CliRunner().invoke(cli, [*words, "--help"], prog_name="codecbench", terminal_width=108)
            print(f"```\n{done.output}```\n")


if __name__ == "__main__":
    main()
