"""Marked blocks of pages, and the stamp that each ends with."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any, Final

from codecbench.core.analysis.run_result import RunResult
from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.hooks import KINDS, Kind
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.storage.environment import describe_environment

Plugins = frozenset[tuple[str, str, str]]
"""Kind, name and version."""
_BLOCK: Final = re.compile(r"<!-- ([\w-]+): begin -->\n(.*?)\n<!-- \1: end -->", re.DOTALL)
_STAMP: Final = re.compile(r"\n\n<sub>(.*); block ([0-9a-f]{8})</sub>$")
_PLUGINS: Final = re.compile(rf"; ({'|'.join(KINDS)}) ([^;]*)")
_FILE: Final = re.compile(r"\]\(([^):]+\.(?:svg|png|jpg|csv))\)")


@dataclass(frozen=True)
class Stamp:
    """When results were computed (their last day), at which commits, on which processors, and by which plugins."""

    day: str
    commits: frozenset[str]
    processors: frozenset[str]
    plugins: Plugins

    @classmethod
    def of_run(cls, run: RunResult) -> Stamp:
        """What a run says of itself."""
        begun = (json.loads(path.read_text())["started_utc"] for path in run.folder.glob("records/*/*/record.json"))
        places = run.environments.values()
        plugins = {plugin for cell in run.plan.cells for plugin in cell.plugins}
        return cls(
            max(begun, default="")[:10],
            frozenset(map(_commit, places)),
            frozenset(map(_processor, places)),
            frozenset((plugin.kind, plugin.name, plugin.version) for plugin in plugins),
        )

    @classmethod
    def of_today(cls, plugins: Iterable[tuple[str, str]]) -> Stamp:
        """Of what is computed here and now by plugins, of each the kind and name."""
        place = describe_environment()
        versions = frozenset((kind, name, version_today(kind, name)) for kind, name in plugins)
        today = datetime.now(UTC).date().isoformat()
        return cls(today, frozenset({_commit(place)}), frozenset({_processor(place)}), versions)

    @classmethod
    def of_all(cls, stamps: Iterable[Stamp]) -> Stamp:
        """Of results that were computed together with others."""
        days, *sets = zip(*((s.day, s.commits, s.processors, s.plugins) for s in stamps), strict=True)
        return cls(max(days), *(frozenset().union(*each) for each in sets))

    def __str__(self) -> str:
        place = f"{self.day}, commit {', '.join(sorted(self.commits))}, {', '.join(sorted(self.processors))}"
        by_kind = groupby(sorted(self.plugins), key=lambda plugin: plugin[0])
        plugins = [f"{kind} {', '.join(f'{name}@{version}' for _, name, version in each)}" for kind, each in by_kind]
        return "; ".join([place, *plugins])


def _commit(place: dict[str, Any]) -> str:
    checkout = place.get("checkout") or {}
    return f"{checkout.get('commit') or 'unknown'}"[:7] + (" with changes" if checkout.get("changed") else "")


def _processor(place: dict[str, Any]) -> str:
    return str(place.get("machine", {}).get("cpu") or "unknown processor")


def version_today(kind: Kind | str, name: str) -> str:
    """The version of an installed plugin; empty if what it needs is not installed."""
    try:
        return str(installed().load(kind, name).version)  # type: ignore[arg-type]
    except CodecbenchError:
        return ""


def blocks_of(page: Path) -> dict[str, str]:
    """What stands between the markers of a page, by name."""
    return dict(_BLOCK.findall(page.read_text()))


def write(page: Path, name: str, content: str, stamp: Stamp | None) -> bool:
    """Replace a block, and end it with a stamp; False if nothing changes. Raises SystemExit if the page lacks it."""
    before = page.read_text()
    small = f"\n\n<sub>{stamp}; block {_digest(page, content)}</sub>" if stamp else ""
    begin, end = f"<!-- {name}: begin -->\n", f"\n<!-- {name}: end -->"
    head, found, rest = before.partition(begin)
    _, found_end, tail = rest.partition(end)
    if not found or not found_end:
        raise SystemExit(f"{page} has no block `{name}`: put {begin.strip()} and {end.strip()} where it shall stand")
    after = head + begin + content + small + end + tail
    if after != before:
        page.write_text(after)
    return after != before


def faults(page: Path, content: str) -> Iterator[str]:
    """Why a block is not what a run of today's plugins made."""
    if not (stamped := _STAMP.search(content)):
        yield "no stamp: no run made it"
        return
    if stamped[2] != _digest(page, content[: stamped.start()]):
        yield "edited after it was made"
    for kind, list_ in _PLUGINS.findall(stamped[1]):
        for name, version in (entry.split("@") for entry in list_.split(", ")):
            today = version_today(kind, name)
            if today and today.partition("+")[0] != version.partition("+")[0]:  # `1+libavif 1.5`: ours is 1
                yield f"made by {kind} {name} {version}, which is {today} today"


def _digest(page: Path, content: str) -> str:
    """Of a block with the figures and tables that it links."""
    digest = hashlib.sha256(content.encode())
    for file in _FILE.findall(content):
        digest.update((page.parent / file).read_bytes())
    return digest.hexdigest()[:8]
