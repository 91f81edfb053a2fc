"""docs/commands.md shows the help that the commands print."""

from __future__ import annotations

import re
import subprocess
import sys

from project import DOCS

from codecbench.cli import COMMANDS

PAGE = (DOCS / "commands.md").read_text()


def test_the_page_shows_today_s_help() -> None:
    script = DOCS / "command_help.py"
    assert subprocess.run([sys.executable, script, "--check"], timeout=120).returncode == 0, f"run {script}"


def test_every_section_shows_its_command_s_help() -> None:
    shown = re.findall(r"```\nUsage: codecbench ([a-z-]+)", PAGE)
    assert set(shown) == set(COMMANDS)
    for name, (_, summary) in COMMANDS.items():
        section = PAGE.split(f"\n## {name}\n")[1].split("\n## ")[0]
        assert section.strip().startswith(summary)
        assert f"Usage: codecbench {name} " in section
