"""Lines that commands print, without rich, which `codecbench list` need not wait for."""

from __future__ import annotations

import os
import shutil
import sys
import textwrap

import click

from codecbench.core.engine.text import clean_text


def say(text: str, *, indent: int = 0, err: bool = False, fg: str | None = None, bold: bool | None = None) -> None:
    """Print a line that may hold text of others. indent: of the lines after the first where it is wrapped.

    It is wrapped between words on a terminal, and where COLUMNS says how wide that is. Else it stays one line, so that
    `tail -n 1` has the whole of the last. Paths and addresses are left whole.
    """
    text = clean_text(text.replace("\n", " "))
    if (sys.stderr if err else sys.stdout).isatty() or "COLUMNS" in os.environ:
        width = shutil.get_terminal_size().columns
        text = textwrap.fill(
            text, width, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
        )
    click.secho(text, err=err, fg=fg, bold=bold)
