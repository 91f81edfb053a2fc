"""The settings that a section of a matrix spells out: without repetitions, and with labels that tell them apart."""

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
    """One setting of a section, and where in the file it stands.

    written: the parameters that stand in the file. description: what the plugin says of it; None where it cannot be
    used here, and `missing` then says why.
    faulty: that is the plugin's own fault. wanted: the search that may try this setting, None where it is always run.
    """

    where: Where
    setting: PluginSetting
    written: frozenset[str] = frozenset()
    name: str | None = None
    description: Description | None = None
    missing: str | None = None
    faulty: bool = False
    wanted: SearchSpec | None = None

    @property
    def requires(self) -> dict[str, str]:
        """Parameters for which stands what other evaluators measure, with the quantity of their metric."""
        return self.description.requires if self.description else {}


def unique_entries(entries: list[Entry]) -> list[Entry]:
    """The entries without those that validate to a setting that came before, but with all that a search may try."""
    kept: list[Entry] = []
    alike: dict[tuple[Any, ...], list[Entry]] = defaultdict(list)
    for entry in entries:
        values = entry.setting.params.values()
        if entry.wanted is not None:
            kept.append(entry)
            continue
        few = alike[tuple(value if isinstance(value, int | float | str) else repr(value) for value in values)]
        if not any(entry.setting == other.setting and entry.name == other.name for other in few):
            few.append(entry)
            kept.append(entry)
    return kept


def label_entries(entries: list[Entry]) -> tuple[Entry, ...]:
    """Give each setting the label that tells it from the other settings of its plugin.

    That of a codec is made of what somebody wrote: what it takes anyway would only make it long.
    """
    same: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for entry in entries:
        same[entry.setting.name].append(entry.setting.params)
    differing = {name: _differing(several) for name, several in same.items()}
    done = []
    for entry in entries:
        params, codec = entry.setting.params, entry.setting.kind == "codec"
        if len(same[entry.setting.name]) > 1:
            keys = [key for key in params if key in differing[entry.setting.name]]
            keys = [key for key in keys if codec and key in entry.written] or keys
        else:
            keys = _explicit(entry) if codec else []
        label = " ".join(f"{key}={_word(params[key])}" for key in keys if params[key] is not None)
        done.append(replace(entry, setting=replace(entry.setting, label=label)))
    return tuple(done)


def _differing(several: list[dict[str, Any]]) -> set[str]:
    """The parameters that are not the same in all settings of a plugin."""
    first = several[0]
    return {key for params in several for key in {**first, **params} if params.get(key) != first.get(key)}


def _explicit(entry: Entry) -> list[str]:
    """Parameters of the only setting of a codec that differ from the defaults."""
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
