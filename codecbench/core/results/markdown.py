"""Markdown tables, and numbers written for people."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence


def table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table; cells are text or numbers, None and NaN become a dash."""
    lines = [
        "| " + " | ".join(heads) + " |",
        "|" + "|".join("---" if not i else "---:" for i in range(len(heads))) + "|",
    ]
    lines += ["| " + " | ".join(cell(value) for value in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def foreign_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table of text that others wrote: markup in it is escaped."""
    shown = ([escaped(value) if isinstance(value, str) else value for value in row] for row in rows)
    return table([escaped(head) for head in heads], shown)


def cell(value: object) -> str:
    """A value as a table shows it: four significant digits, thousands apart where it is a count."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return "–"
    if isinstance(value, float):
        if math.isinf(value):
            return "∞"
        if value.is_integer() and abs(value) >= 10_000:
            return f"{int(value):,}"
        return f"{value:.4g}" if abs(value) < 10_000 else f"{value:,.0f}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return " ".join(str(value).split("\n")).replace("|", "\\|")


def escaped(text: str) -> str:
    """Foreign text that a page would otherwise take for markup: links, pictures, HTML, code, emphasis."""
    return re.sub(r"[\\`*\[\]]", r"\\\g<0>", text).replace("&", "&amp;").replace("<", "&lt;")


def change(ours: float, theirs: float) -> str:
    """How far our number is from theirs, in percent."""
    if math.isnan(ours) or not theirs:
        return "–"
    return f"{100 * (ours - theirs) / theirs:+.0f} %"
