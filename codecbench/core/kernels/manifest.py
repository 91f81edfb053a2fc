"""Manifests: a package's `kernels.json` lists the kernel signatures that its users call, to be compiled ahead.

`codecbench warm-up MATRIX --record PACKAGE` writes one by running whatever calls the kernels, one line a signature. It
decides only what is compiled ahead: a missing signature is compiled at its first call, an unused one costs time once.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from numba.core import event

from codecbench.core.kernels.argument_types import ArgumentTypeError, text_from_types, types_from_text
from codecbench.core.kernels.cache import Build, KernelCache, write_atomically
from codecbench.core.kernels.folders import read_trusted

MANIFEST = "kernels.json"


class ManifestError(Exception):
    """A manifest is missing, cannot be read, or names a kernel that does not exist."""


@dataclass(frozen=True, order=True)
class Entry:
    """A signature of a kernel that is called from Python."""

    kernel: str
    """`module:function`."""
    build: Build
    arguments: str
    """Types, as in `argument_types`."""
    seconds: float
    """Time to compile it and what it calls, when the manifest was recorded; the slowest are started first."""
    stage: int = 0
    """0 if any work calls it; more if only longer work does, which can begin before it is compiled."""

    def is_cached(self) -> bool:
        """Return whether its machine code is on disk, or is never stored. Raises ManifestError if it does not exist."""
        files = self.files()
        return not files or any(file.exists() for file in files)

    def files(self) -> list[Path]:
        """Return the files that may hold its machine code, as `KernelCache.files`. Raises as `is_cached` does."""
        dispatcher, arguments = self._resolve()
        files: list[Path] = dispatcher._cache.files(arguments, dispatcher.targetctx.codegen())
        return files

    def compile(self) -> None:
        """Compile it and what it calls, unless that is in the cache. Raises ManifestError as `is_cached` does."""
        dispatcher, arguments = self._resolve()
        dispatcher.compile(arguments)

    def copy_to(self, folder: Path) -> None:
        """Copy its machine code into a folder. Raises ManifestError as `is_cached` does, or if there is no code."""
        content = next((content for file in self.files() if (content := read_trusted(file))), None)
        if content is None:
            raise ManifestError(f"kernel {self.kernel} ({self.build}) is not kept on disk, and cannot be copied")
        write_atomically(folder / self.files()[0].name, content)

    def _resolve(self) -> tuple[Any, tuple[Any, ...]]:
        """Return its dispatcher and numba types. Raises ManifestError if there is no such signature."""
        module, _, name = self.kernel.partition(":")
        try:
            kernel = getattr(importlib.import_module(module), name)
            arguments = types_from_text(self.arguments)
            cache = getattr(kernel, "_cache", None)
            dispatcher = kernel if isinstance(cache, KernelCache) else kernel.dispatcher(self.build)
            return dispatcher, arguments
        except (ImportError, AttributeError, TypeError, ArgumentTypeError) as error:
            raise ManifestError(f"kernel {self.kernel} ({self.build}) cannot be compiled ahead: {error}") from error


def entries_of(name: str) -> tuple[Entry, ...]:
    """Return the entries of a package's or module's kernels, from the manifest beside it or above it.

    Raises ManifestError if there is no manifest or it cannot be read.
    """
    package = name
    while package:
        path = _manifest_path(package)
        if path is not None and path.is_file():
            entries = _read(path)
            return tuple(entry for entry in entries if f"{entry.kernel}.".replace(":", ".").startswith(f"{name}."))
        package = package.rpartition(".")[0]
    raise ManifestError(f"no {MANIFEST} beside {name} or above it; record it: codecbench warm-up --help")


def manifest_file(package: str, entries: Iterable[Entry]) -> tuple[Path, bytes]:
    """Return the path of a package's manifest and its content: the entries whose kernels are in the package."""
    path = _manifest_path(package)
    if path is None:
        raise ManifestError(f"{package} is not a package with a folder; name one that can be imported")
    package_entries = sorted(entry for entry in entries if entry.kernel.startswith((f"{package}.", f"{package}:")))
    return path, ("[\n" + ",\n".join(json.dumps(asdict(entry)) for entry in package_entries) + "\n]\n").encode()


def _manifest_path(package: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(package)
    except ImportError:
        return None
    folders = spec.submodule_search_locations if spec is not None else None
    return Path(os.fspath(folders[0])) / MANIFEST if folders else None


def _read(path: Path) -> list[Entry]:
    try:
        return [Entry(**values) for values in json.loads(path.read_text(encoding="utf-8"))]
    except (OSError, ValueError, TypeError) as error:
        raise ManifestError(f"{path} cannot be read: {error}; record it again: codecbench warm-up --help") from error


class Recorder(event.Listener):  # type: ignore[misc,unused-ignore]
    """Records what is compiled for calls from Python; what those kernels call is compiled inside."""

    entries: list[Entry]
    """What was compiled so far."""
    stage: int
    """Stage of what is compiled from now on."""

    def __init__(self) -> None:
        self.entries = []
        self.stage = 0
        self._started: list[float] = []

    def on_start(self, event: Any) -> None:
        self._started.append(time.perf_counter())

    def on_end(self, event: Any) -> None:
        seconds = time.perf_counter() - self._started.pop()
        cache = getattr(event.data["dispatcher"], "_cache", None)
        if self._started or not isinstance(cache, KernelCache) or "<locals>" in cache.kernel:
            return
        with suppress(ArgumentTypeError):
            arguments = text_from_types(event.data["args"])
            self.entries.append(Entry(cache.kernel, cache.build, arguments, round(seconds, 1), self.stage))


@contextmanager
def record_compilations() -> Iterator[Recorder]:
    """Record the signatures compiled for calls from Python: with an empty cache, all that are called."""
    recorder = Recorder()
    with event.install_listener("numba:compile", recorder):
        yield recorder
