"""Which signatures of kernels a package's users call: `kernels.json` beside it, so that they can be compiled ahead.

A manifest is made by running whatever calls the kernels (`codecbench warm-up MATRIX --record PACKAGE`) and holds one
line a signature. It decides nothing but what is compiled ahead: a signature that it lacks is compiled at its first
call, one that nothing calls any more costs time once.
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
from codecbench.core.kernels.cache import Build, KernelCache, write_whole
from codecbench.core.kernels.trust import read_trusted

MANIFEST = "kernels.json"


class ManifestError(Exception):
    """A manifest that is not there, cannot be read, or names what there is not."""


@dataclass(frozen=True, order=True)
class Entry:
    """A signature of a kernel that is called from Python.

    kernel: `module:function`. arguments: as in `argument_types`. seconds: what compiling it and whatever it calls took
    when the manifest was made, which says what to start first. stage: 0 for what any work calls, above that for what
    only longer work comes to, which can begin before it is compiled.
    """

    kernel: str
    build: Build
    arguments: str
    seconds: float
    stage: int = 0

    def is_kept(self) -> bool:
        """Whether its machine code is on disk, or never is. Raises ManifestError where there is no such signature."""
        places = self.places()
        return not places or any(file.exists() for file in places)

    def places(self) -> list[Path]:
        """Files in which its machine code may be, as `KernelCache.places` has them. Raises as `is_kept` does."""
        dispatcher, arguments = self._resolved()
        places: list[Path] = dispatcher._cache.places(arguments, dispatcher.targetctx.codegen())
        return places

    def compile(self) -> None:
        """Compile it and whatever it calls, unless that is in the cache. Raises ManifestError as `is_kept` does."""
        dispatcher, arguments = self._resolved()
        dispatcher.compile(arguments)

    def copy_to(self, folder: Path) -> None:
        """Copy its machine code into a folder. Raises ManifestError as `is_kept` does, and where there is no code."""
        content = next((content for file in self.places() if (content := read_trusted(file))), None)
        if content is None:
            raise ManifestError(f"kernel {self.kernel} ({self.build}) is not kept on disk, and cannot be copied")
        write_whole(folder / self.places()[0].name, content)

    def _resolved(self) -> tuple[Any, tuple[Any, ...]]:
        module, _, name = self.kernel.partition(":")
        try:
            kernel = getattr(importlib.import_module(module), name)
            arguments = types_from_text(self.arguments)
            cache = getattr(kernel, "_cache", None)
            dispatcher = kernel if isinstance(cache, KernelCache) else kernel.dispatcher(self.build)
            return dispatcher, arguments
        except (ImportError, AttributeError, TypeError, ArgumentTypeError) as error:
            raise ManifestError(f"kernel {self.kernel} ({self.build}) cannot be compiled ahead: {error}") from error


def listed(name: str) -> tuple[Entry, ...]:
    """The entries of the package or module `name`: those of its kernels in the manifest beside it or above it.

    Raises ManifestError where there is no manifest or it cannot be read.
    """
    package = name
    while package:
        path = _beside(package)
        if path is not None and path.is_file():
            entries = _read(path)
            return tuple(entry for entry in entries if f"{entry.kernel}.".replace(":", ".").startswith(f"{name}."))
        package = package.rpartition(".")[0]
    raise ManifestError(f"no {MANIFEST} beside {name} or above it; record it: codecbench warm-up --help")


def recorded(package: str, entries: Iterable[Entry]) -> tuple[Path, bytes]:
    """The file of the manifest of `package` and its content: those of the entries whose kernels are in it."""
    path = _beside(package)
    if path is None:
        raise ManifestError(f"{package} is not a package with a folder; name one that can be imported")
    own = sorted(entry for entry in entries if entry.kernel.startswith((f"{package}.", f"{package}:")))
    return path, ("[\n" + ",\n".join(json.dumps(asdict(entry)) for entry in own) + "\n]\n").encode()


def _beside(package: str) -> Path | None:
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
    """Notes what is compiled for calls from Python; what that calls in turn is compiled inside it.

    entries: what was compiled so far. stage: of what is compiled from now on.
    """

    def __init__(self) -> None:
        self.entries: list[Entry] = []
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
def recording() -> Iterator[Recorder]:
    """The signatures that are compiled meanwhile for calls from Python: all that are called, if the cache is empty."""
    recorder = Recorder()
    with event.install_listener("numba:compile", recorder):
        yield recorder
