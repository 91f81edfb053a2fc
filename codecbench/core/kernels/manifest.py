"""Manifests: a package's `kernels.json` lists the kernel signatures that its users call, to be compiled ahead.

`codecbench warm-up MATRIX --record PACKAGE` writes one by running whatever calls the kernels, one line a signature. It
decides only what is compiled ahead: a missing signature is compiled at its first call, an unused one costs time once.

Argument types are written as readable text:

    int64    float64[:, ::1]    readonly(uint8[::1])    (float64, float64)    omitted(7)    none
    named("package.module:Views", float64[:, ::1], int64[::1])

Arrays are written as in numba: `::1` marks the contiguous dimension. `named` is a named tuple, by its class and the
types of its fields.
"""

from __future__ import annotations

import ast
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

import numba.core.types
from numba.core import event

from codecbench.core.kernels.cache import Build, KernelCache, write_atomically
from codecbench.core.kernels.folders import read_trusted

types: Any = numba.core.types  # numba is typed in part, and differently in each version

MANIFEST = "kernels.json"

_SCALARS = {str(scalar): scalar for scalar in (*types.number_domain, types.boolean)}
_DIMENSIONS = {"C": (":", "::1"), "F": ("::1", ":"), "A": (":", ":")}


class ArgumentTypeError(ValueError):
    """A type has no text, or a text names no type."""


class ManifestError(Exception):
    """A manifest is missing, cannot be read, or names a kernel that does not exist."""


@dataclass(frozen=True, order=True)
class Entry:
    """A signature of a kernel that is called from Python."""

    kernel: str
    """`module:function`."""
    build: Build
    arguments: str
    """Argument types, as `text_from_types` writes them."""
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
            raise ManifestError(f"kernel {self.kernel} ({self.build}) is not stored on disk and cannot be copied")
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
    raise ManifestError(f"no {MANIFEST} for {name} in its package or above; record it: codecbench warm-up --help")


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


def text_from_types(arguments: tuple[Any, ...]) -> str:
    """Return the types of a call's arguments, separated by commas. Raises ArgumentTypeError if one has no text."""
    return ", ".join(map(_text_from_type, arguments))


def types_from_text(text: str) -> tuple[Any, ...]:
    """Parse the text of `text_from_types` into numba types. Raises ArgumentTypeError for anything else."""
    try:
        tree = ast.parse(f"({text},)" if text else "()", mode="eval").body
        return tuple(_type_from_node(part) for part in tree.elts)  # type: ignore[attr-defined]
    except (SyntaxError, KeyError, ValueError, TypeError, AttributeError, ImportError) as error:
        raise ArgumentTypeError(f"{text!r} is not a list of argument types: {type(error).__name__}: {error}") from error


def _text_from_type(numba_type: Any) -> str:
    if str(numba_type) in _SCALARS:
        return str(numba_type)
    if isinstance(numba_type, types.Array) and numba_type.aligned and type(numba_type) is types.Array:
        return _array_text(numba_type)
    if isinstance(numba_type, types.BaseNamedTuple):
        tuple_class = numba_type.instance_class
        return f'named("{tuple_class.__module__}:{tuple_class.__qualname__}", {text_from_types(tuple(numba_type))})'
    if isinstance(numba_type, types.BaseTuple):
        parts = text_from_types(tuple(numba_type))
        return f"({parts},)" if len(numba_type) == 1 else f"({parts})"
    if isinstance(numba_type, types.Omitted) and isinstance(numba_type.value, int | float | bool | None):
        return f"omitted({numba_type.value!r})"
    if isinstance(numba_type, types.NoneType):
        return "none"
    raise ArgumentTypeError(f"no text for the argument type {numba_type}; allowed are numbers, arrays and tuples")


def _array_text(array: Any) -> str:
    first, last = _DIMENSIONS[array.layout]
    dimensions = [":"] * array.ndim
    if dimensions:
        dimensions[0] = first
        dimensions[-1] = last if array.ndim > 1 or array.layout == "A" else "::1"
    text = f"{_text_from_type(array.dtype)}[{', '.join(dimensions) or '()'}]"
    return text if array.mutable else f"readonly({text})"


def _type_from_node(node: ast.expr) -> Any:
    if isinstance(node, ast.Name):
        return types.none if node.id == "none" else _SCALARS[node.id]
    if isinstance(node, ast.Subscript):
        return _array_from_node(node)
    if isinstance(node, ast.Tuple):
        return types.BaseTuple.from_types([_type_from_node(part) for part in node.elts])
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return _type_from_call(node.func.id, node.args)
    raise ValueError(ast.unparse(node))


def _array_from_node(node: ast.Subscript) -> Any:
    parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    steps = [ast.unparse(part) for part in parts]
    contiguous = [dimension for dimension, step in enumerate(steps) if step == "::1"]
    if any(step not in (":", "::1") for step in steps) or len(contiguous) > 1:
        raise ValueError(ast.unparse(node))
    layouts = {len(steps) - 1: "C", 0: "F"} if len(steps) > 1 else {0: "C"}
    layout = layouts[contiguous[0]] if contiguous else "A" if steps else "C"
    return types.Array(_type_from_node(node.value), len(steps), layout)


def _type_from_call(name: str, arguments: list[ast.expr]) -> Any:
    """Return the type that is written as a call: `readonly`, `omitted` or `named`."""
    if name == "readonly":
        array = _type_from_node(arguments[0])
        return types.Array(array.dtype, array.ndim, array.layout, readonly=True)
    if name == "omitted":
        return types.Omitted(ast.literal_eval(arguments[0]))
    if name != "named":
        raise ValueError(f"{name}(...)")
    module, _, qualname = str(ast.literal_eval(arguments[0])).partition(":")
    tuple_class: Any = importlib.import_module(module)
    for part in qualname.split("."):
        tuple_class = getattr(tuple_class, part)
    return types.BaseTuple.from_types([_type_from_node(part) for part in arguments[1:]], tuple_class)
