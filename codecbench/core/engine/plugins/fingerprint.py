"""Fingerprint a plugin's code: it changes with every edit, whether or not a version was raised.

Nothing is imported. The fingerprint depends on how the plugin was installed:

    another distribution, copied files   its version and its RECORD
    another distribution, from source    the files of the plugin's package, and modules beside it that it imports
    codecbench's own plugin              the modules outside the core that it imports

Imports count directly or not. The core's effect on results is in every identity (`RECORD_FORMAT`), and an edit of one
codec does not concern another.
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
"""Lists of what is compiled ahead, which change when something is compiled."""
_SHARED_FOLDERS: Final = ("site-packages", "dist-packages")
"""Folders that pip installs into: other modules there belong to other distributions."""
_LARGE_BYTES: Final = 16 << 20
"""Larger files, such as weights, are fingerprinted by size and modification time."""


def code_label(kind: Kind, name: str) -> str:
    """Return the label of a plugin's code in records: `codec jpeg`."""
    return f"{kind} {name}"


def code_of(plugin: Plugin) -> str:
    """Return the plugin's distribution with its version, and the fingerprint; empty if its code is not found."""
    code_fingerprint = fingerprint(plugin.foreign, _module(plugin))
    return f"{plugin.distribution} {code_fingerprint}" if code_fingerprint else ""


def code_digest(code: dict[str, str]) -> str:
    """Digest the fingerprints of several plugins by label, without versions; empty if there are none."""
    return digest({label: fingerprint.rpartition(" ")[2] for label, fingerprint in code.items()}) if code else ""


def files_since(plugin: Plugin, time_s: float) -> list[str]:
    """Return names of the plugin's files that were modified after `time_s`, in seconds since 1970."""
    names = []
    for path in () if _installed_copy(plugin.foreign) else _files(plugin.foreign, _module(plugin)):
        with suppress(OSError):
            if path.stat().st_mtime > time_s:
                names.append(path.name)
    return sorted(names)


def fingerprint(foreign: str, module: str) -> str:
    """Fingerprint a module's code; empty if it is not found. foreign: its distribution, empty for codecbench."""
    installed = _installed_copy(foreign)
    if installed is not None:
        return digest([installed.version, sorted(_record_lines(installed))])[:16]
    content = hashlib.blake2b(digest_size=8)
    has_files = False
    for path in _files(foreign, module):
        with suppress(OSError):  # it is being replaced; the next call sees it
            state = path.stat()
            content.update(f"{path.name} {_file_digest(path, state.st_size, state.st_mtime_ns)}\n".encode())
            has_files = True
    return content.hexdigest() if has_files else ""


def _module(plugin: Plugin) -> str:
    return plugin.spec.target.partition(":")[0]


def _installed_copy(foreign: str) -> Distribution | None:
    """Return another distribution if its files were copied at installation; otherwise None."""
    if not foreign:
        return None
    try:
        installed = distribution(foreign.partition(" ")[0])
    except (PackageNotFoundError, ValueError):
        return None
    with suppress(ValueError, AttributeError):
        if json.loads(installed.read_text("direct_url.json") or "{}").get("dir_info", {}).get("editable"):
            return None
    return installed if any(_record_lines(installed)) else None


def _record_lines(installed: Distribution) -> Iterator[str]:
    """Yield the lines of its RECORD, path and hash, for the files of its packages."""
    for line in (installed.read_text("RECORD") or "").splitlines():
        path = line.partition(",")[0].strip('"')
        if ".dist-info/" not in path and not path.startswith(("..", "/")) and not path.endswith((*_COMPILED, ".pth")):
            yield line


def _files(foreign: str, module: str) -> list[Path]:
    """Return the files that contain the code of a module, sorted."""
    location = _package_location(module)
    if location is None:
        return []
    package, top = location
    if not foreign:
        return sorted(_imported_files(module, top, _outside_core))
    files = {package} if package.is_file() else set(_files_below(package))
    return sorted(files if top.name in _SHARED_FOLDERS else files | _imported_files(module, top, _outside_codecbench))


def _package_location(module: str) -> tuple[Path, Path] | None:
    """Return the folder or file of the package that a module is in, and the folder on the path in which it was found.

    The package is the topmost one below namespace packages, which distributions share.
    """
    with suppress(IndexError):
        spec = module_spec(module, to_first_file=True)
        if spec is not None:
            folder = Path(next(iter(spec.submodule_search_locations or ()), spec.origin or ""))
            return folder, folder.parents[spec.name.count(".")]
    return None


def _files_below(folder: Path) -> Iterator[Path]:
    for parent, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if name != "__pycache__" and not name.startswith(".")]
        for name in names:
            if not name.startswith(".") and not name.endswith(_COMPILED):
                yield Path(parent, name)


def _imported_files(module: str, top: Path, select: Callable[[Iterable[str]], Iterable[str]]) -> set[Path]:
    """Return the files of a module and of those in the folder `top` that it imports, directly or not.

    Data files beside them in packages are included. select: filters the imported names.
    """
    waiting, files = [*select([module])], set()
    while waiting:
        path = _module_file(waiting.pop(), top)
        if path is None or path in files:
            continue
        files.add(path)
        with suppress(OSError):
            state = path.stat()
            package = ".".join(path.relative_to(top).parent.parts)
            waiting += select(_imports(path, package, state.st_size, state.st_mtime_ns))
    data = (other for folder in {path.parent for path in files} - {top} for other in folder.iterdir())
    return files | {path for path in data if path.is_file() and _is_data(path)}


def _is_data(path: Path) -> bool:
    return path.suffix not in (".py", ".typed", *_COMPILED) and path.name not in _LISTS and path.name[0] != "."


def _module_file(module: str, top: Path) -> Path | None:
    path = top.joinpath(*module.split("."))
    return next((file for file in (path.with_name(f"{path.name}.py"), path / "__init__.py") if file.is_file()), None)


@functools.cache
def _imports(path: Path, package: str, size: int, written_ns: int) -> tuple[str, ...]:
    """Return the names that a file imports: modules, and names that may be modules. Cached by size and time."""
    names: list[str] = []
    with suppress(SyntaxError, ValueError, RecursionError, ImportError):  # foreign files may be invalid
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
    """Yield names of other distributions, each after its parent packages, which are imported too."""
    for name in names:
        if name.partition(".")[0] != OURS:
            yield from accumulate(name.split("."), "{}.{}".format)


@functools.cache
def _file_digest(path: Path, size: int, written_ns: int) -> str:
    if size > _LARGE_BYTES:
        return f"{size} {written_ns}"
    return hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest()
