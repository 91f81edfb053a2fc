"""Report kept cells whose plugins' code has changed since: they are kept, but not silently."""

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
"""Label of the encoder's code among the code of a cell that reads bitstreams."""
_SHOWN: Final = 3


@dataclass
class _Change:
    """One plugin whose code changed: kept cells, what changed, and names for `--recompute`."""

    description: str
    cells: set[str] = field(default_factory=set)
    names: dict[str, None] = field(default_factory=dict)

    def line(self, title: str) -> str:
        names = list(self.names)
        options = " ".join(f"--recompute {name}" for name in names[:_SHOWN]) + (" ..." if len(names) > _SHOWN else "")
        cells = f"{len(self.cells)} kept cell{'s' if len(self.cells) > 1 else ''}"
        made = f"{title}: other code computed {cells} ({self.description})"
        return f"{made}; to recompute them: codecbench run ... {options}"


def code_notices(plan: Plan, kept_entries: Mapping[str, IndexEntry], store: Store, registry: Registry) -> list[str]:
    """Return a line for each plugin whose code differs from what made some kept cells, and one for cells without code.

    kept_entries: index entries of the cells with a result. Opens one record for each combination of codes that differs.
    """
    today = _Today(registry)
    differences: dict[tuple[str, str], list[tuple[str, str, str]]] = {}
    changes: dict[tuple[str, str], _Change] = {}
    unknown = 0
    for cell in plan.cells:
        if (entry := kept_entries.get(cell.id)) is None:
            continue
        code = today.code(cell)
        unknown += not entry.code
        pair = entry.code, code_digest(code)
        if not entry.code or pair[0] == pair[1]:
            continue
        if pair not in differences:
            differences[pair] = list(today.differences(cell, code, store))
        for title, description, kind in differences[pair]:
            change = changes.setdefault((title, description), _Change(description))
            change.cells.add(cell.id)
            change.names[_recompute_name(cell, kind)] = None
    lines = [change.line(title) for (title, _), change in changes.items()]
    if unknown:
        lines.append(f"{unknown} kept cell(s) were computed before codecbench recorded the code of plugins; whether it "
                     "has changed since is unknown")  # fmt: skip
    return lines


class _Today:
    """The current code of plugins, each looked up once."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._code: dict[tuple[Kind, str], str] = {}

    def code(self, cell: Cell) -> dict[str, str]:
        """Return the code that a new record of the cell would have."""
        codes = {code_label(setting.kind, setting.name): self._of(setting) for setting in cell.plugins}
        if cell.job_id is not None:
            codes[BITSTREAMS_LABEL] = self._of(cell.codec)
        return {label: code for label, code in codes.items() if code}

    def differences(self, cell: Cell, now: dict[str, str], store: Store) -> Iterator[tuple[str, str, str]]:
        """Yield for each plugin that differs its label, what changed, and its kind."""
        try:
            record = store.read_record(cell.id)
        except StoreError:
            return  # damaged or gone: reported elsewhere
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
        plugin_key = setting.kind, setting.name
        if plugin_key not in self._code:
            try:
                self._code[plugin_key] = code_of(self._registry.find(*plugin_key))
            except PluginError:
                self._code[plugin_key] = ""  # no longer installed: there is no code to compare with
        return self._code[plugin_key]


def _recompute_name(cell: Cell, kind: str) -> str:
    """Return the name for `--recompute` of a cell whose plugin of this kind has changed."""
    if kind == "codec":
        return cell.codec.name
    return cell.sequence.name if kind == "dataset" else cell.evaluator.name
