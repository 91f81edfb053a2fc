"""Which code a plugin is made of, as a fingerprint: it changes with an edit, whether or not a version was raised.

Of another distribution that was installed as copied files, its version and what its RECORD lists. Of one that is loaded
from where it is written (editable, or found on the path) the files of the package that the plugin is in, and the
modules beside it that the plugin's imports lead to. Of our own, the modules outside the core that the plugin's imports
lead to: what the core does to results is in every identity (`RECORD_FORMAT`), and an edit of one codec says nothing
about another. Nothing is imported.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import json
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from importlib.util import resolve_name
from itertools import accumulate
from pathlib import Path
from typing import Final

from codecbench.core.contracts.hooks import Kind
from codecbench.core.engine.identity import digest
from codecbench.core.engine.plugins.plugin import OURS, Plugin, module_spec

_CORE: Final = f"{OURS}.core"
_COMPILED: Final = (".pyc", ".pyo", ".nbi", ".nbc")
_LISTS: Final = ("kernels.json",)
"""What is compiled ahead: it changes when something is compiled, not what."""
_SHARED_FOLDERS: Final = ("site-packages", "dist-packages")
"""What pip installs into: what lies beside a package there is of other distributions."""
_LARGE_BYTES: Final = 16 << 20
"""Larger files, such as weights, count by size and time of writing."""


def code_label(kind: Kind, name: str) -> str:
    """What the code of a plugin is called in records: `codec jpeg`."""
    return f"{kind} {name}"


def code_of(plugin: Plugin) -> str:
    """The plugin's distribution with its version, and the fingerprint; empty where its code is not found."""
    found = fingerprint(plugin.foreign, _module(plugin))
    return f"{plugin.distribution} {found}" if found else ""


def code_digest(code: dict[str, str]) -> str:
    """A digest of the fingerprints of several plugins by label, without versions; empty where there are none."""
    return digest({label: fingerprint.rpartition(" ")[2] for label, fingerprint in code.items()}) if code else ""


def files_since(plugin: Plugin, time_s: float) -> list[str]:
    """Names of the plugin's files that were written after `time_s`, in seconds since 1970."""
    found = []
    for path in () if _installed_copy(plugin.foreign) else _files(plugin.foreign, _module(plugin)):
        with suppress(OSError):
            if path.stat().st_mtime > time_s:
                found.append(path.name)
    return sorted(found)


def fingerprint(foreign: str, module: str) -> str:
    """That of the code of a module; empty where it is not found. foreign: its distribution, empty for codecbench."""
    installed = _installed_copy(foreign)
    if installed is not None:
        return digest([installed.version, sorted(_record_lines(installed))])[:16]
    content = hashlib.blake2b(digest_size=8)
    found = False
    for path in _files(foreign, module):
        with suppress(OSError):  # it is being replaced; the next look finds it
            state = path.stat()
            content.update(f"{path.name} {_file_digest(path, state.st_size, state.st_mtime_ns)}\n".encode())
            found = True
    return content.hexdigest() if found else ""


def _module(plugin: Plugin) -> str:
    return plugin.spec.target.partition(":")[0]


def _installed_copy(foreign: str) -> Distribution | None:
    """A distribution of others whose files were copied when it was installed; None for all others."""
    if not foreign:
        return None
    try:
        found = distribution(foreign.partition(" ")[0])
    except (PackageNotFoundError, ValueError):
        return None
    with suppress(ValueError, AttributeError):
        if json.loads(found.read_text("direct_url.json") or "{}").get("dir_info", {}).get("editable"):
            return None
    return found if any(_record_lines(found)) else None


def _record_lines(installed: Distribution) -> Iterator[str]:
    """Lines of its RECORD, path and hash, of the files of its packages."""
    for line in (installed.read_text("RECORD") or "").splitlines():
        path = line.partition(",")[0].strip('"')
        if ".dist-info/" not in path and not path.startswith(("..", "/")) and not path.endswith((*_COMPILED, ".pth")):
            yield line


def _files(foreign: str, module: str) -> list[Path]:
    """The files that the code of a module is in, in order."""
    found = _package_location(module)
    if found is None:
        return []
    place, top = found
    if not foreign:
        return sorted(_imported_files(module, top, _outside_core))
    files = {place} if place.is_file() else set(_files_below(place))
    return sorted(files if top.name in _SHARED_FOLDERS else files | _imported_files(module, top, _outside_codecbench))


def _package_location(module: str) -> tuple[Path, Path] | None:
    """The folder or file of the package that a module is in, the first below those that distributions share, and the
    folder on the path that it was found in."""
    with suppress(IndexError):
        spec = module_spec(module, to_first_file=True)
        if spec is not None:
            place = Path(next(iter(spec.submodule_search_locations or ()), spec.origin or ""))
            return place, place.parents[spec.name.count(".")]
    return None


def _files_below(folder: Path) -> Iterator[Path]:
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__" and not name.startswith(".")]
        for name in names:
            if not name.startswith(".") and not name.endswith(_COMPILED):
                yield Path(parent, name)


def _imported_files(module: str, top: Path, counted: Callable[[Iterable[str]], Iterable[str]]) -> set[Path]:
    """The files of a module, of those in the folder `top` that it leads to, and the data beside them in packages.

    counted: which of the names that a module imports count.
    """
    waiting, found = [*counted([module])], set()
    while waiting:
        path = _module_file(waiting.pop(), top)
        if path is None or path in found:
            continue
        found.add(path)
        with suppress(OSError):
            state = path.stat()
            package = ".".join(path.relative_to(top).parent.parts)
            waiting += counted(_imports(path, package, state.st_size, state.st_mtime_ns))
    data = (other for folder in {path.parent for path in found} - {top} for other in folder.iterdir())
    return found | {path for path in data if path.is_file() and _is_data(path)}


def _is_data(path: Path) -> bool:
    return path.suffix not in (".py", ".typed", *_COMPILED) and path.name not in _LISTS and path.name[0] != "."


def _module_file(module: str, top: Path) -> Path | None:
    path = top.joinpath(*module.split("."))
    return next((file for file in (path.with_name(f"{path.name}.py"), path / "__init__.py") if file.is_file()), None)


@functools.cache
def _imports(path: Path, package: str, size: int, written_ns: int) -> tuple[str, ...]:
    """What a file in a package, of this size and time, imports: modules, and names that may be some."""
    names: list[str] = []
    with suppress(SyntaxError, ValueError, RecursionError, ImportError):  # of others, and nothing to run
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.Import):
                names += [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                module = resolve_name("." * node.level + (node.module or ""), package)
                names += [module, *(f"{module}.{alias.name}" for alias in node.names)]
    return tuple(names)


def _outside_core(names: Iterable[str]) -> Iterator[str]:
    return (name for name in names if name.startswith(f"{OURS}.") and not f"{name}.".startswith(f"{_CORE}."))


def _outside_codecbench(names: Iterable[str]) -> Iterator[str]:
    """Names of others, each after the packages that it is in, which are imported too."""
    for name in names:
        if name.partition(".")[0] != OURS:
            yield from accumulate(name.split("."), "{}.{}".format)


@functools.cache
def _file_digest(path: Path, size: int, written_ns: int) -> str:
    if size > _LARGE_BYTES:
        return f"{size} {written_ns}"
    return hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest()
