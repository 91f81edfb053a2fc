"""What the README says first is what the pages behind it show."""

from __future__ import annotations

import re
import shlex

import click
from project import DOCS, ROOT

from codecbench.cli import cli

README = (ROOT / "README.md").read_text()


def block(page: str, name: str) -> list[list[str]]:
    """The cells of a marked block's rows."""
    (text,) = re.findall(rf"<!-- {name}: begin -->(.*?)<!-- {name}: end -->", (DOCS / page).read_text(), re.DOTALL)
    lines = [line for line in text.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[1:] if not line.startswith("|---")]


def test_the_finding_is_the_verdict_s() -> None:
    """Taken at 0.2 bit a pixel are WebP and JPEG 2000 by the two tasks, AVIF at 0.5 and 1, and nowhere JPEG."""
    taken = {(row[1], row[2].strip("`").split(" ")[0]) for row in block("verdict.md", "tasks-decided")}
    assert {codec for rate, codec in taken if rate == "0.2 bit/px"} == {"webp", "jpeg2000"}
    assert {codec for rate, codec in taken if rate != "0.2 bit/px"} == {"avif"}
    assert "WebP and JPEG 2000 are ahead at 0.2 bit a pixel and AVIF at 0.5 and 1" in README


def test_what_memory_saves_is_the_page_s() -> None:
    rows = [row for row in block("video.md", "streams-ordered") if row[2] in ("h264", "av1", "hevc")]
    saved = [-int(row[3].removesuffix(" %")) for row in rows if row[0] == "localisation AUC"]
    least, most = re.findall(r"take (\d+) to (\d+) % less rate than JPEG", README)[0]
    assert (min(saved), max(saved)) == (int(least), int(most))


def test_the_first_screen_is_short() -> None:
    """A sentence, the finding with its figure and two commands come before anything else."""
    first = README.split("## Your own recording")[0]
    assert first.count("![") == 1
    assert len(first.splitlines()) < 40
    assert "|---" not in first


def test_every_command_is_one_that_the_command_line_takes() -> None:
    """Its name, options and values; what it names need not be there."""
    commands = set(re.findall(r"(?:`|bin/)codecbench ((?:--confine )?[a-z-]+(?: [^`\n&]+)?)", README))
    assert {"try PATH", "run examples/first.yaml", "verify-run BUNDLE"} <= commands
    for words in commands:
        name, *rest = shlex.split(words.removeprefix("--confine "))
        context = click.Context(cli)
        command = cli.get_command(context, name)
        assert command is not None, words
        command.make_context(name, rest, parent=context)
