"""How many cells a matrix may ask for, found out before any is made."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from codecbench.core.engine.planning.search import Search
from codecbench.core.engine.planning.yaml_file import Problems

if TYPE_CHECKING:
    from codecbench.core.engine.planning.entry import Entry

_MOST_CELLS: Final = 1_000_000


def require_plannable(
    sections: Mapping[str, tuple[Entry, ...]], searches: tuple[Search, ...], problems: Problems
) -> None:
    """Raise MatrixError for more cells than can be planned: the sections meet each other."""
    counts = {section: len(entries) for section, entries in sections.items()}
    counts["codecs"] = sum(entry.wanted is None for entry in sections["codecs"])
    counts["codecs"] += sum(min(search.budget, len(search.settings)) for search in searches)
    cells = math.prod(counts.values())
    if cells > _MOST_CELLS:
        spelled = " x ".join(f"{count:,} {section}" for section, count in counts.items())
        problems.add((), f"{spelled} = {cells:,} cells; at most {_MOST_CELLS:,} are planned")
        problems.raise_any()
