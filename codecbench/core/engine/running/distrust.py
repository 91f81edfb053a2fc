"""Which finished cells cannot be relied on once code was found to change what its worker computes with."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.planning.model import Cell
from codecbench.core.engine.storage.store import Store


def made_beside(
    company: Sequence[str], worker: dict[str, Any], cells: Iterable[Cell], store: Store
) -> Iterator[tuple[Cell, bool]]:
    """Those of these cells that were computed beside a distribution of this company, and not found right since.

    worker: as records name it, the one that was found changed; all that it did is among them. So is what was computed
    in such company before workers were checked after each cell, and what does not say in whose company it was
    computed. With each cell, whether its bitstreams are to be encoded again: they were made beside it too, or are gone.
    """
    culprits = set(company)
    for cell in cells:
        try:
            made_by = store.read_record(cell.id).worker
        except StoreError:
            made_by = {}
        beside = made_by.get("company")
        if isinstance(beside, list):
            changed = all(made_by.get(name) == worker[name] for name in ("host", "pid"))
            if not culprits.intersection(beside) or (made_by.get("checked") is True and not changed):
                continue
        coded_beside = culprits.intersection((cell.sequence.dataset.distribution, cell.codec.distribution))
        gone = cell.job_id is not None and not store.has_coded(cell.job_id, cell.sequence.frames)
        yield cell, gone or bool(coded_beside) or not isinstance(beside, list)


def beside_notice(cells: int, company: Sequence[str]) -> str:
    """What a run says of them."""
    counted = "1 cell that was" if cells == 1 else f"{cells} cells that were"
    return f"{counted} computed beside {' or '.join(company)}, which changes its process, will be computed again"
