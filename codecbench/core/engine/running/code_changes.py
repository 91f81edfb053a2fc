"""What a run says of kept cells whose plugins' code is no longer what it was: they are kept, and not in silence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Final

from codecbench.core.contracts.errors import PluginError, StoreError
from codecbench.core.contracts.hooks import Kind
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting
from codecbench.core.engine.plugins.fingerprint import code_digest, code_label, code_of, files_since
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.storage.record import Record
from codecbench.core.engine.storage.record_index import IndexEntry
from codecbench.core.engine.storage.store import Store

BITSTREAMS_LABEL: Final = "bitstreams"
"""What the code that encoded is called among the code of a cell that reads bitstreams."""
_SHOWN: Final = 3


@dataclass
class _Change:
    """One plugin whose code changed: kept cells, what changed, and the names by which they are computed again."""

    what: str
    cells: set[str] = field(default_factory=set)
    names: dict[str, None] = field(default_factory=dict)

    def line(self, title: str) -> str:
        names = list(self.names)
        options = " ".join(f"--recompute {name}" for name in names[:_SHOWN]) + (" ..." if len(names) > _SHOWN else "")
        counted = f"{len(self.cells)} kept cell{'s' if len(self.cells) > 1 else ''}"
        return f"{title}: other code made {counted} ({self.what}); to make them again: codecbench run ... {options}"


def code_notices(plan: Plan, kept: Mapping[str, IndexEntry], store: Store, registry: Registry) -> list[str]:
    """A line for each plugin whose code is not what made some of the kept cells, and one for cells that do not say.

    kept: the index of those with a result. It opens one record for each combination of codes that differs.
    """
    today = _Today(registry)
    differences: dict[tuple[str, str], list[tuple[str, str, str]]] = {}
    changes: dict[tuple[str, str], _Change] = {}
    unknown = 0
    for cell in plan.cells:
        if (entry := kept.get(cell.id)) is None:
            continue
        now = today.code(cell)
        unknown += not entry.code
        pair = entry.code, code_digest(now)
        if not entry.code or pair[0] == pair[1]:
            continue
        if pair not in differences:
            differences[pair] = list(today.differences(cell, now, store))
        for title, what, name in differences[pair]:
            change = changes.setdefault((title, what), _Change(what))
            change.cells.add(cell.id)
            change.names[_recompute_name(cell, name)] = None
    lines = [change.line(title) for (title, _), change in changes.items()]
    if unknown:
        lines.append(f"{unknown} kept cell(s) were computed before codecbench recorded the code of plugins; whether it "
                     "has changed since is unknown")  # fmt: skip
    return lines


class _Today:
    """The code of plugins as it is now, looked at once."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._code: dict[tuple[Kind, str], str] = {}

    def code(self, cell: Cell) -> dict[str, str]:
        """What a record of the cell would tell."""
        found = {code_label(setting.kind, setting.name): self._of(setting) for setting in cell.plugins}
        if cell.job_id is not None:
            found[BITSTREAMS_LABEL] = self._of(cell.codec)
        return {label: code for label, code in found.items() if code}

    def differences(self, cell: Cell, now: dict[str, str], store: Store) -> Iterator[tuple[str, str, str]]:
        """Of each plugin that differs its label, what changed, and whose name asks for its cells: `dataset` or so."""
        try:
            record = store.read_record(cell.id)
        except StoreError:
            return  # damaged or gone, which is another reason
        by_label = {code_label(setting.kind, setting.name): setting for setting in cell.plugins}
        by_label[BITSTREAMS_LABEL] = cell.codec
        seen = set()
        for label in record.code.keys() & now.keys():
            setting, before = by_label[label], record.code[label]
            title = code_label(setting.kind, setting.name)
            if before.rpartition(" ")[2] != now[label].rpartition(" ")[2] and title not in seen:
                seen.add(title)
                yield title, self._change(setting, before, now[label], record), setting.kind

    def _change(self, setting: PluginSetting, before: str, now: str, record: Record) -> str:
        then, today = before.rpartition(" ")[0], now.rpartition(" ")[0]
        if then != today:
            return f"{then} then, {today} now"
        try:
            made_s = datetime.fromisoformat(record.started_utc).timestamp()
            names = files_since(self._registry.find(setting.kind, setting.name), made_s)
        except (ValueError, PluginError):
            names = []
        more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
        return f"{today}: " + (f"{', '.join(names[:_SHOWN])}{more} written since" if names else "its files differ")

    def _of(self, setting: PluginSetting) -> str:
        asked = setting.kind, setting.name
        if asked not in self._code:
            try:
                self._code[asked] = code_of(self._registry.find(*asked))
            except PluginError:
                self._code[asked] = ""  # no longer installed: there is no code to compare with
        return self._code[asked]


def _recompute_name(cell: Cell, kind: str) -> str:
    """The name by which a cell is computed again whose plugin of this kind has changed."""
    if kind == "codec":
        return cell.codec.name
    return cell.sequence.name if kind == "dataset" else cell.evaluator.name
