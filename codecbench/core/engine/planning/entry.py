"""Entries of a matrix section: one per setting, without duplicates and with labels that distinguish them."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Any

from codecbench.core.engine.planning.description import Description
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.planning.search_section import SearchSpec
from codecbench.core.engine.planning.yaml_file import Where


@dataclass(frozen=True)
class Entry:
    """One setting of a section, with its position in the file."""

    where: Where
    setting: PluginSetting
    written: frozenset[str] = frozenset()
    """Names of the parameters that the file sets."""
    name: str | None = None
    description: Description | None = None
    """The plugin's description; None if the plugin cannot be used here."""
    missing: str | None = None
    """Why the plugin cannot be used here, if `description` is None."""
    faulty: bool = False
    """Whether `missing` is the plugin's own fault."""
    search: SearchSpec | None = None
    """The search that may try this setting; None if it always runs."""

    @property
    def requires(self) -> dict[str, str]:
        """Parameters whose value another evaluator measures, with the quantity of its metric."""
        return self.description.requires if self.description else {}


def unique_entries(entries: list[Entry]) -> list[Entry]:
    """Drop entries that validate to an earlier setting; keep all that a search may try."""
    unique: list[Entry] = []
    alike: dict[tuple[Any, ...], list[Entry]] = defaultdict(list)
    for entry in entries:
        values = entry.setting.params.values()
        if entry.search is not None:
            unique.append(entry)
            continue
        candidates = alike[tuple(value if isinstance(value, int | float | str) else repr(value) for value in values)]
        if not any(entry.setting == other.setting and entry.name == other.name for other in candidates):
            candidates.append(entry)
            unique.append(entry)
    return unique


def label_entries(entries: list[Entry]) -> tuple[Entry, ...]:
    """Give each setting the label that distinguishes it from the other settings of its plugin.

    A codec's label contains only parameters that the file sets: defaults would only make it longer.
    """
    params_by_plugin: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for entry in entries:
        params_by_plugin[entry.setting.name].append(entry.setting.params)
    differing = {name: _differing(group) for name, group in params_by_plugin.items()}
    labelled = []
    for entry in entries:
        params, codec = entry.setting.params, entry.setting.kind == "codec"
        if len(params_by_plugin[entry.setting.name]) > 1:
            keys = [key for key in params if key in differing[entry.setting.name]]
            keys = [key for key in keys if codec and key in entry.written] or keys
        else:
            keys = _explicit(entry) if codec else []
        label = " ".join(f"{key}={_word(params[key])}" for key in keys if params[key] is not None)
        labelled.append(replace(entry, setting=replace(entry.setting, label=label)))
    return tuple(labelled)


def _differing(group: list[dict[str, Any]]) -> set[str]:
    """Return the parameters that are not the same in all settings of a plugin."""
    first = group[0]
    return {key for params in group for key in {**first, **params} if params.get(key) != first.get(key)}


def _explicit(entry: Entry) -> list[str]:
    """Return the parameters of a codec's only setting that differ from their defaults."""
    return list(entry.setting.params) if entry.description is None else entry.description.explicit


def _word(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    if isinstance(value, list):
        return ",".join(_word(item) for item in value)
    if isinstance(value, dict):
        return ",".join(f"{key}:{_word(item)}" for key, item in value.items())
    return str(value)
