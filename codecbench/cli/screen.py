"""The terminal as rich draws on it."""

from __future__ import annotations

from rich.console import Console


class Screen(Console):
    """A console whose reader may stop reading: that is an error like any other, and does not end the process here."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError
