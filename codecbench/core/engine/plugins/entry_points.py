"""Entry points of installed distributions. Nothing is imported."""

from __future__ import annotations

import functools
import sys
from importlib.metadata import Distribution, EntryPoint, PackageNotFoundError, distribution, entry_points

from codecbench.core.contracts import hooks
from codecbench.core.engine.plugins.plugin import OURS


def origins() -> list[str]:
    """Return all distributions with entry points of codecbench, with their versions."""
    return sorted({origin_of(point) for point in entry_points(group=hooks.GROUP)})


def origin_of(point: EntryPoint) -> str:
    """Return the distribution of an entry point with its version; if it has none, the entry point's value."""
    return " ".join(_name_and_version(point.dist)) if point.dist else point.value


def points_by_origin() -> dict[str, list[EntryPoint]]:
    """Return the entry points: codecbench's own under `OURS`, those of others by distribution."""
    points: dict[str, list[EntryPoint]] = {}
    for point in _points(tuple(sys.path)):
        is_own = point.dist is not None and _name_and_version(point.dist)[0] == OURS
        points.setdefault(OURS if is_own else origin_of(point), []).append(point)
    return points


def points_of(origin: str) -> list[EntryPoint]:
    """Return the entry points of a distribution, given with or without version; empty if it is not installed."""
    name, _, version = origin.partition(" ")
    try:
        installed = distribution(name)
    except (PackageNotFoundError, ValueError):
        return []
    matches = not version or installed.version == version
    return [point for point in installed.entry_points if point.group == hooks.GROUP and matches]


@functools.cache
def _name_and_version(distribution: Distribution) -> tuple[str, str]:
    """Return a distribution's name and version; cached, because each access parses a file."""
    metadata = distribution.metadata
    return metadata["Name"], metadata["Version"]


@functools.cache
def _points(path: tuple[str, ...]) -> tuple[EntryPoint, ...]:
    """Return all entry points on this path; cached, because it reads a file of every distribution."""
    return tuple(entry_points(group=hooks.GROUP))


def own_plugins_first(point: EntryPoint) -> tuple[bool, str, str]:
    """Sort key: codecbench's own plugins come first, so that nobody can take one of their names."""
    distribution = _name_and_version(point.dist)[0] if point.dist else ""
    return (distribution != OURS, distribution, point.name)
