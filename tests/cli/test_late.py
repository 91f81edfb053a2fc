"""The command line loads most of codecbench only when a command needs it."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

import pytest

from codecbench.cli import COMMANDS
from codecbench.cli.late import LATE


def test_late_modules_exist() -> None:
    assert [name for name in sorted(LATE) if find_spec(name) is None] == []


@pytest.mark.parametrize("command", [command for command in COMMANDS if command not in ("data", "verify")])
def test_help_of_a_command_loads_nothing_heavy(command: str) -> None:
    heavy = "'numpy', 'pandas', 'pydantic', 'rich', 'scipy', 'numba', 'cv2', 'yaml'"
    code = (
        f"import sys; sys.argv = ['codecbench', {command!r}, '--help']\n"
        "from codecbench.cli import cli\n"
        "cli(standalone_mode=False)\n"
        f"print(*({{{heavy}}} & sys.modules.keys()), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.split() == []
