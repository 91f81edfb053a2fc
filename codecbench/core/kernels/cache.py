"""Disk cache of compiled kernels, keyed by all that their machine code depends on.

numba's own cache is keyed by one file's content: callers miss changes of constants and of kernels in other files. Two
processes that fill its index at once can also mix it up. Here each compiled signature is one file, named by a digest of
all that it depends on and written atomically. One process compiles it while others that need it wait. Loading runs the
file as code, so only files that this user or root wrote are loaded (`folders`).
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import pickle
import platform
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import llvmlite  # type: ignore[import-untyped]
import numba
import numba.core.types
from numba.core import caching, compiler, serialize, sigutils

from codecbench.core.kernels.folders import FILE_MODE, FOLDER_MODE, kernel_folder, precompiled_folders, read_trusted
from codecbench.core.kernels.source import SourceError

# numba is typed in part and differently in each version; the tests of this module check what it does.
_settings: Any = numba.config
_serialize: Any = serialize
_result: Any = compiler.CompileResult
_arguments: Any = sigutils.normalize_signature
_types: Any = numba.core.types

_DIGEST_BYTES = 32

Build = Literal["fast", "counting"]
"""`fast`: a kernel as written. `counting`: the kernel with operation counters added."""


class KernelCache(caching._Cache):  # type: ignore[misc,unused-ignore]
    """The disk cache of one build of one kernel, in the form that a numba dispatcher uses.

    A folder that is not writable or not trusted costs compile time, nothing else.
    """

    def __init__(self, kernel: str, build: Build, fingerprint: Callable[[], str]) -> None:
        """kernel: `module:function`. fingerprint: returns a digest of all that the source depends on.

        It is called once, when the first signature is needed, so that all globals of the source are defined. If it
        raises SourceError, as for functions that close over variables, nothing is cached.
        """
        self.kernel, self.build = kernel, build
        self._compute_fingerprint = fingerprint

    @cached_property
    def _fingerprint(self) -> str | None:
        try:
            return self._compute_fingerprint()
        except SourceError:
            return None

    @property
    def cache_path(self) -> str:
        return str(kernel_folder())

    def file(self, signature: Any, codegen: Any) -> Path | None:
        """Return the file in which a signature's machine code is stored; None if it is never stored."""
        folder = kernel_folder()
        if self._fingerprint is None or folder is None:
            return None
        arguments, result = _arguments(signature)
        versions = (numba.__version__, llvmlite.__version__, sys.version_info[:2], platform.machine())
        settings = (_settings.OPT, _settings.BOUNDSCHECK, _settings.LOOP_VECTORIZE)
        named_tuples = tuple(_named_tuples(arguments))  # numba writes a named tuple with the bare name of its class
        key = (self._fingerprint, arguments, result, codegen.magic_tuple(), versions, settings, *named_tuples)
        name = "".join(letter for letter in self.kernel.replace(":", ".") if letter.isalnum() or letter in "._-")
        return folder / f"{name}.{self.build}-{hashlib.sha256(repr(key).encode()).hexdigest()[:24]}.bin"

    def files(self, signature: Any, codegen: Any) -> list[Path]:
        """Return the files that may hold a signature's machine code: the cache's own, then precompiled ones."""
        file = self.file(signature, codegen)
        return [file, *(folder / file.name for folder in precompiled_folders())] if file is not None else []

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load a compiled signature; None if it is missing, damaged or not trusted."""
        target_context.refresh()
        for file in self.files(sig, target_context.codegen()):
            content = read_trusted(file) or b""
            digest, payload = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
            if hashlib.sha256(payload).digest() == digest:
                return _result._rebuild(target_context, *pickle.loads(payload))
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled signature, unless its code contains addresses of this process."""
        if data.library.has_dynamic_globals or any(not lifted.can_cache for lifted in data.lifted):
            return
        file = self.file(sig, data.codegen)
        if file is None or file.exists():
            return
        payload = _serialize.dumps(data._reduce())
        with suppress(OSError):
            write_atomically(file, hashlib.sha256(payload).digest() + payload)

    def enable(self) -> None:
        """Do nothing: the cache is always on."""

    def disable(self) -> None:
        """Do nothing: the cache is always on."""

    def flush(self) -> None:
        """Do nothing: an entry is never out of date."""


class CompileOnce:
    """A dispatcher's compiler: one process at a time compiles a signature, and others load the result.

    Signatures have types only, no constants.
    """

    def __init__(self, compiler: Any, cache: KernelCache, target_context: Any) -> None:
        self._compiler, self._cache, self._target_context = compiler, cache, target_context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._compiler, name)

    def fold_argument_types(self, args: Any, kws: Any) -> Any:
        """Return the argument types of a call in another kernel, with constants as plain numbers.

        numba would compile the function again for each constant. Nothing is lost: the optimizer sees the caller with
        the function inlined, where the constant is known.
        """
        signature, folded = self._compiler.fold_argument_types(args, kws)
        return signature, tuple(map(_types.unliteral, folded))

    def compile(self, args: Any, return_type: Any) -> Any:
        """Load or compile a signature; it is on disk before another process may look for it."""
        file = self._cache.file(args, self._target_context.codegen())
        with _lock(file):
            cached = self._cache.load_overload(args, self._target_context) if file is not None else None
            if cached is not None:
                self._target_context.insert_user_function(cached.entry_point, cached.fndesc, [cached.library])
                return cached
            if file is not None:
                with suppress(OSError):
                    file.unlink()  # damaged, or it would have been loaded
            result = self._compiler.compile(args, return_type)
            self._cache.save_overload(args, result)
            return result


def _named_tuples(types: Iterable[Any]) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield module, name and fields of the named tuples among types, also of those inside other tuples."""
    for tuple_type in types:
        if isinstance(tuple_type, _types.BaseNamedTuple):
            tuple_class = tuple_type.instance_class
            yield tuple_class.__module__, tuple_class.__qualname__, tuple_class._fields
        if isinstance(tuple_type, _types.BaseTuple):
            yield from _named_tuples(tuple_type)


_locked_files: set[Path] = set()
"""Files whose locks this process holds: kernels that call each other in a circle come back to them."""


@contextmanager
def _lock(file: Path | None) -> Iterator[None]:
    """Hold the lock of a cache file; the system releases it if the process is killed."""
    if file is None or file in _locked_files:
        yield
        return
    path = file.with_suffix(".lock")
    try:
        _make_folder(path.parent)
        lock_file = open(path, "w", encoding="ascii")  # noqa: SIM115 - closed below, whatever is compiled inside
    except OSError:
        yield
        return
    with lock_file:
        _locked_files.add(file)
        try:
            fcntl.flock(lock_file, fcntl.LOCK_EX)
            yield
        finally:
            _locked_files.discard(file)
            path.unlink(missing_ok=True)


def write_atomically(file: Path, content: bytes) -> None:
    """Write a file of machine code, completely or not at all; only its owner may write to it."""
    _make_folder(file.parent)
    handle, unfinished = tempfile.mkstemp(dir=file.parent)
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            os.fchmod(stream.fileno(), FILE_MODE)
        os.replace(unfinished, file)
    except BaseException:
        Path(unfinished).unlink(missing_ok=True)
        raise


def _make_folder(folder: Path) -> None:
    """Create a folder that only its owner may write to, whatever the umask is."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=FOLDER_MODE, exist_ok=True)
