"""In which format a command writes; `md` and `markdown` are one word."""

from __future__ import annotations

from typing import Any

import click


class Format(click.Choice[str]):
    """One of these formats. `markdown` may be written `md`."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        return super().convert("markdown" if value == "md" and "markdown" in self.choices else value, param, ctx)
