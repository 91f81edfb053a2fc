"""What distributions offer, as data: reported by their hosts, and cached by a digest of their files."""

from __future__ import annotations

import json
import os
import sys
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, Final

from codecbench.core.contracts.errors import CodecbenchError, PluginError
from codecbench.core.contracts.hooks import GROUP, KINDS, PluginSpec
from codecbench.core.engine.hosting.host import Host
from codecbench.core.engine.identity import digest
from codecbench.core.engine.plugins.fingerprint import fingerprint
from codecbench.core.engine.plugins.plugin import Plugin, Problem, fault_of
from codecbench.core.kernels.folders import cache_folder

_ASKED: Final = "codecbench.core.engine.plugins.serving:offers"


@dataclass(frozen=True)
class Offers:
    """The plugins of a distribution, each with the name of its entry point, and the problems of others."""

    plugins: list[tuple[Plugin, str]]
    problems: list[Problem]


def cached_offers(origin: str, points: list[EntryPoint]) -> Offers | None:
    """Return what a distribution offered if its files have not changed, otherwise None. points: its entry points."""
    with suppress(OSError, ValueError, LookupError, TypeError, PluginError):
        cache = json.loads(_cache_file(origin).read_bytes())
        if cache["files"] == _files_digest(origin, points):
            return _parse_offers(origin, cache["offers"])
    return None


def ask_offers(host: Host, points: list[EntryPoint]) -> Offers:
    """Ask a distribution's host what it offers, and cache the answer if there is no problem.

    An unreadable answer becomes one of its problems.
    """
    origin, files = host.distribution, _files_digest(host.distribution, points)
    try:
        value = host.ask(_ASKED)
        offers = _parse_offers(origin, value)
    except CodecbenchError as error:
        reason = f"its entry points cannot be read: {' '.join(str(error).split())}"
        return Offers([], [Problem(origin, GROUP, reason, nameless=True)])
    if files is not None and not offers.problems:
        _write_cache(_cache_file(origin), {"files": files, "offers": value})
    return offers


def _parse_offers(origin: str, value: Any) -> Offers:
    """Parse a host's answer. Raises PluginError if it is malformed: the distribution's code runs there too."""
    plugins: list[tuple[Plugin, str]] = []
    try:
        problems = [
            Problem(origin, str(problem["entry_point"]), str(problem["reason"]), bool(problem["nameless"]))
            for problem in value["problems"]
        ]
        for values in value["plugins"]:
            spec = PluginSpec(**{**values["spec"], "requires": tuple(values["spec"]["requires"])})
            if values["kind"] not in KINDS or fault_of(values["kind"], spec) is not None:
                raise ValueError(spec)
            plugins.append((Plugin(values["kind"], spec, origin, hosted=True), str(values["entry_point"])))
    except (LookupError, TypeError, ValueError, AttributeError):
        raise PluginError("it sent an invalid answer") from None
    return Offers(plugins, problems)


def _files_digest(origin: str, points: list[EntryPoint]) -> str | None:
    """Return a digest of everything that determines a distribution's offers; None if its code is not found."""
    codes = [(point.name, point.value, fingerprint(origin, point.module)) for point in points]
    return digest([sys.version, codes]) if all(code for *_, code in codes) else None


def _cache_file(origin: str) -> Path:
    return cache_folder() / "offers" / f"{digest([sys.prefix, origin.partition(' ')[0]])}.json"


def _write_cache(file: Path, value: dict[str, Any]) -> None:
    with suppress(OSError, TypeError, ValueError):  # if it cannot be written, the host is asked again
        file.parent.mkdir(parents=True, exist_ok=True)
        new = file.with_suffix(f".{os.getpid()}")
        new.write_text(json.dumps(value), encoding="utf-8")
        os.replace(new, file)
