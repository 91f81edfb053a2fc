"""The help of every command on docs/commands.md: `python docs/command_help.py` puts in what the commands print.

With --check nothing is written; the exit status is 1 if a text differs.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

from click.testing import CliRunner

from codecbench.cli import cli

PAGE = Path(__file__).parent / "commands.md"
WIDTH = 108


def with_help(page: str) -> str:
    """The page with each block that begins with a command's usage replaced by the help that it prints now."""
    return re.sub(r"```\nUsage: codecbench ([a-z -]+?) (?=\[|[A-Z]).*?```", _help, page, flags=re.DOTALL)


def _help(block: re.Match[str]) -> str:
    result = CliRunner().invoke(cli, [*block[1].split(), "--help"], prog_name="codecbench", terminal_width=WIDTH)
    if result.exit_code:
        raise SystemExit(f"codecbench {block[1]} --help: {result.output}")
    return f"```\n{result.output}```"


def main() -> None:
    before = PAGE.read_text()
    after = with_help(before)
    if "--check" in sys.argv[1:]:
        sys.exit(int(before != after))
    PAGE.write_text(after)


if __name__ == "__main__":
    main()
