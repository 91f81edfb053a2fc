"""What the Tab key offers."""

from __future__ import annotations

import os
import re
import subprocess

import pytest
from click.shell_completion import BashComplete
from installed_command import COMMAND
from project import DOCS

from codecbench.cli import COMMANDS, cli


def offered(*words: str) -> list[str]:
    """Values after `codecbench WORDS`, of which the last is not finished."""
    complete = BashComplete(cli, {}, "codecbench", "_CODECBENCH_COMPLETE")
    return [item.value for item in complete.get_completions(list(words[:-1]), words[-1])]


def test_commands() -> None:
    assert offered("") == list(COMMANDS)
    assert offered("ver") == ["verify-run", "verify"]


@pytest.mark.parametrize(
    "words", [("verify", "jp"), ("export", "RUN", "--codec", "jp"), ("try", "PATH", "--codec", "jp"), ("schema", "jp")]
)
def test_names_of_codecs(words: tuple[str, ...]) -> None:
    found = offered(*words)
    assert {"jpeg", "jpeg2000", "jpeg_qf"} <= set(found)
    assert all(name.startswith("jp") for name in found)


def test_names_of_evaluators_and_formats() -> None:
    assert offered("run", "--recompute", "qual") == ["quality"]
    assert offered("table", "RUN", "--format", "mark") == ["markdown"]


def test_the_command_answers_the_shell_as_the_page_says() -> None:
    page = (DOCS / "commands.md").read_text().split("## Shell completion")[1].split("\n## ")[0]
    variables = re.findall(r"(_[A-Z_]+)=(\w+_source)", page)
    assert variables[0] == ("_CODECBENCH_COMPLETE", "bash_source")
    script = asked(_CODECBENCH_COMPLETE="bash_source")
    assert "complete -o nosort -F _codecbench_completion codecbench" in script
    answer = asked(_CODECBENCH_COMPLETE="bash_complete", COMP_WORDS="codecbench verify multilevel_s", COMP_CWORD="2")
    assert answer == "plain,multilevel_stream\n"


def asked(**variables: str) -> str:
    done = subprocess.run([COMMAND], env={**os.environ, **variables}, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout
