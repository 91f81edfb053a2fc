"""README.md is short, its numbers come from commands, and its commands are there; docs/index.md lists every page."""

from __future__ import annotations

import re
import shlex

import click
import yaml
from project import DOCS, ROOT

from codecbench.cli import cli

README = (ROOT / "README.md").read_text()
INDEX = (DOCS / "index.md").read_text()
PAGE = r"\]\(([\w/-]+\.md)\)"
NAMES = r"JPEG 2000|H\.264|ORB-SLAM3|Python 3\.11|Apache-2\.0|GPL-3"
"""What has a digit and is no measurement."""


def test_every_number_is_in_a_block_that_a_command_made() -> None:
    """Outside of blocks, commands, links and names of codecs a digit is a claim that nothing makes again."""
    own = re.sub(
        r"<!-- ([\w-]+): begin -->.*?<!-- \1: end -->|```.*?```|`[^`]*`|\]\([^)]*\)", "", README, flags=re.DOTALL
    )
    assert "Two commands" in own
    assert [line for line in re.sub(NAMES, "", own).splitlines() if re.search(r"\d|%", line)] == []


def test_it_is_read_in_three_minutes() -> None:
    assert len(README.split()) <= 900
    assert len(INDEX.split()) <= 200


def test_the_picture_comes_before_the_two_commands_and_these_before_a_recording() -> None:
    headings = re.findall(r"^## (.*)$", README, re.MULTILINE)
    assert headings[:2] == ["Two commands", "Your own recording"]
    assert README.index("![") < README.index("## Two commands")
    assert len(re.findall(r"^python3 -m venv ", README, re.MULTILINE)) == 2


def test_every_command_is_one_that_the_command_line_takes() -> None:
    """Its name, options and values; what it names need not be there."""
    commands = set(re.findall(r"(?:`|bin/)codecbench ([a-z-]+(?: [^`\n&]+)?)", README))
    assert {"try PATH", "report runs/first"} <= commands
    assert any(words.startswith("run examples/") for words in commands)
    for words in commands:
        name, *rest = shlex.split(words)
        context = click.Context(cli, **cli.context_settings)
        command = cli.get_command(context, name)
        assert command is not None, words
        if rest:
            command.make_context(name, rest, parent=context)


def test_the_index_lists_every_page_in_the_order_of_the_navigation() -> None:
    def pages(entry: object) -> list[str]:
        if isinstance(entry, str):
            return [entry]
        return [page for each in (entry.values() if isinstance(entry, dict) else entry) for page in pages(each)]  # type: ignore[attr-defined]

    navigation = pages(yaml.safe_load((ROOT / "mkdocs.yml").read_text().partition("plugins:")[0])["nav"])
    assert ["index.md", *re.findall(PAGE, INDEX)] == [
        page for page in navigation if not page.startswith("reference/") or page == "reference/index.md"
    ]
    assert {str(page.relative_to(DOCS)) for page in DOCS.glob("**/*.md")} == set(navigation)
