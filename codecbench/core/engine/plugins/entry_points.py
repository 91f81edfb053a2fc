"""Entry points of what is installed, by distribution. Nothing is imported."""

from __future__ import annotations

import functools
import sys
from importlib.metadata import Distribution, EntryPoint, PackageNotFoundError, distribution, entry_points

from codecbench.core.contracts import hooks
from codecbench.core.engine.plugins.plugin import OURS


def origins() -> list[str]:
    """All distributions that have entry points of codecbench, with their versions. Imports none."""
    return sorted({origin_of(point) for point in entry_points(group=hooks.GROUP)})


def origin_of(point: EntryPoint) -> str:
    """The distribution of an entry point with its version; where it has none, what it names."""
    return " ".join(_name_and_version(point.dist)) if point.dist else point.value


def points_by_origin() -> dict[str, list[EntryPoint]]:
    """The entry points of what is installed: codecbench's own, and those of others by distribution."""
    found: dict[str, list[EntryPoint]] = {}
    for point in _points(tuple(sys.path)):
        own = point.dist is not None and _name_and_version(point.dist)[0] == OURS
        found.setdefault(OURS if own else origin_of(point), []).append(point)
    return found


def points_of(origin: str) -> list[EntryPoint]:
    """The entry points of a distribution, by its name, with its version or without; none where it is not installed."""
    name, _, version = origin.partition(" ")
    try:
        found = distribution(name)
    except (PackageNotFoundError, ValueError):
        return []
    wanted = not version or found.version == version
    return [point for point in found.entry_points if point.group == hooks.GROUP and wanted]


@functools.cache
def _name_and_version(distribution: Distribution) -> tuple[str, str]:
    """Name and version, for which a file is read and parsed whenever they are asked for."""
    metadata = distribution.metadata
    return metadata["Name"], metadata["Version"]


@functools.cache
def _points(path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """All entry points on this path, looked for once: it means reading a file of every distribution."""
    return tuple(entry_points(group=hooks.GROUP))


def own_plugins_first(point: EntryPoint) -> tuple[bool, str, str]:
    """Codecbench's own plugins come first, so that nobody can take one of their names."""
    distribution = _name_and_version(point.dist)[0] if point.dist else ""
    return (distribution != OURS, distribution, point.name)
