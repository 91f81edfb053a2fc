"""Compiled kernels on disk, found again by everything that their machine code depends on.

numba's own cache is keyed by one file's content, so that a change of a kernel in another file, or of a
constant, goes unnoticed by its callers; and its index can mix up two processes that fill it at once. Here
every compiled signature is one file whose name is a digest of all that it depends on, written whole, and compiled by
one process while others that want it wait. Loading runs it, so only what this user or root wrote is loaded (`trust`).
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

from codecbench.core.kernels.source import SourceError
from codecbench.core.kernels.trust import FILE_MODE, FOLDER_MODE, given_folders, kernel_folder, read_trusted

# numba is typed in part and differently in each version; what it does is checked by the tests of this module.
_settings: Any = numba.config
_serialize: Any = serialize
_result: Any = compiler.CompileResult
_arguments: Any = sigutils.normalize_signature
_types: Any = numba.core.types

_DIGEST_BYTES = 32

Build = Literal["fast", "counting"]
"""What is made of the source of a kernel: the function itself, or the function with counters in it."""


class KernelCache(caching._Cache):  # type: ignore[misc,unused-ignore]
    """The cache of one build of one kernel, in the form that a numba dispatcher uses.

    kernel: `module:function`. build: which build of it. fingerprint: gives a digest of everything that the source
    depends on; asked once, when the first signature is wanted and all that the source names is defined. For a
    function whose code does not say all that it does (it closes over variables), nothing is kept. A folder that cannot
    be written to, or is not to be trusted, costs compile time, nothing else.
    """

    def __init__(self, kernel: str, build: Build, fingerprint: Callable[[], str]) -> None:
        self.kernel, self.build = kernel, build
        self._compute = fingerprint

    @cached_property
    def _fingerprint(self) -> str | None:
        try:
            return self._compute()
        except SourceError:
            return None

    @property
    def cache_path(self) -> str:
        return str(kernel_folder())

    def file(self, signature: Any, codegen: Any) -> Path | None:
        """Where the machine code of a signature is kept once it is compiled; None where it never is."""
        folder = kernel_folder()
        if self._fingerprint is None or folder is None:
            return None
        arguments, result = _arguments(signature)
        versions = (numba.__version__, llvmlite.__version__, sys.version_info[:2], platform.machine())
        settings = (_settings.OPT, _settings.BOUNDSCHECK, _settings.LOOP_VECTORIZE)
        named = tuple(_named_tuples(arguments))  # numba writes a named tuple with the bare name of its class
        key = (self._fingerprint, arguments, result, codegen.magic_tuple(), versions, settings, *named)
        name = "".join(letter for letter in self.kernel.replace(":", ".") if letter.isalnum() or letter in "._-")
        return folder / f"{name}.{self.build}-{hashlib.sha256(repr(key).encode()).hexdigest()[:24]}.bin"

    def places(self, signature: Any, codegen: Any) -> list[Path]:
        """Files in which the machine code of a signature may be: its own, then those that came from elsewhere."""
        file = self.file(signature, codegen)
        return [file, *(folder / file.name for folder in given_folders())] if file is not None else []

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled signature, or None where it is not there, damaged or not to be trusted."""
        target_context.refresh()
        for file in self.places(sig, target_context.codegen()):
            content = read_trusted(file) or b""
            digest, payload = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
            if hashlib.sha256(payload).digest() == digest:
                return _result._rebuild(target_context, *pickle.loads(payload))
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled signature, unless its code holds addresses of this very process."""
        if data.library.has_dynamic_globals or any(not lifted.can_cache for lifted in data.lifted):
            return
        file = self.file(sig, data.codegen)
        if file is None or file.exists():
            return
        payload = _serialize.dumps(data._reduce())
        with suppress(OSError):
            write_whole(file, hashlib.sha256(payload).digest() + payload)

    def enable(self) -> None:
        """Nothing to do: the cache is always on."""

    def disable(self) -> None:
        """Nothing to do: the cache is always on."""

    def flush(self) -> None:
        """Nothing to do: an entry can never be out of date."""


class CompileOnce:
    """A dispatcher's compiler: one process at a time compiles a signature, others take what it made.

    A signature has types only, no constants.
    """

    def __init__(self, compiler: Any, cache: KernelCache, target_context: Any) -> None:
        self._compiler, self._cache, self._target_context = compiler, cache, target_context

    def __getattr__(self, name: str) -> Any:
        return getattr(self._compiler, name)

    def fold_argument_types(self, args: Any, kws: Any) -> Any:
        """Types of the arguments of a call in another kernel, where a constant is a number like any other.

        numba would compile the function again for each constant. Nothing is lost: what is optimised is the caller with
        the function inside it, and there the constant is known.
        """
        signature, folded = self._compiler.fold_argument_types(args, kws)
        return signature, tuple(map(_types.unliteral, folded))

    def compile(self, args: Any, return_type: Any) -> Any:
        """What numba makes of the signature; kept on disk before another process may ask for it."""
        file = self._cache.file(args, self._target_context.codegen())
        with _locked(file):
            found = self._cache.load_overload(args, self._target_context) if file is not None else None
            if found is not None:
                self._target_context.insert_user_function(found.entry_point, found.fndesc, [found.library])
                return found
            if file is not None:
                with suppress(OSError):
                    file.unlink()  # damaged, or it would have been found
            made = self._compiler.compile(args, return_type)
            self._cache.save_overload(args, made)
            return made


def _named_tuples(types: Iterable[Any]) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Module, name and fields of the named tuples among types, also inside of other tuples."""
    for tuple_type in types:
        if isinstance(tuple_type, _types.BaseNamedTuple):
            named = tuple_type.instance_class
            yield named.__module__, named.__qualname__, named._fields
        if isinstance(tuple_type, _types.BaseTuple):
            yield from _named_tuples(tuple_type)


_held: set[Path] = set()
"""Files whose locks this process holds: kernels that call each other in a circle meet their own."""


@contextmanager
def _locked(file: Path | None) -> Iterator[None]:
    """Hold the lock of a file of the cache, which its process gives back even when it is killed."""
    if file is None or file in _held:
        yield
        return
    path = file.with_suffix(".lock")
    try:
        _make_folder(path.parent)
        lock = open(path, "w", encoding="ascii")  # noqa: SIM115 - closed below, whatever is compiled inside
    except OSError:
        yield
        return
    with lock:
        _held.add(file)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX)
            yield
        finally:
            _held.discard(file)
            path.unlink(missing_ok=True)


def write_whole(file: Path, content: bytes) -> None:
    """Write a file of machine code, complete or not at all, that nobody else may write."""
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
    """Make a folder that nobody else may write, whatever the umask is."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=FOLDER_MODE, exist_ok=True)
