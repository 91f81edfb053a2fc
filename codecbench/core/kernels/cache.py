"""Compiled kernels on disk, found again by everything that their machine code depends on.

numba's own cache is keyed by one file's content, so that a change of a kernel in another file, or of a
constant, goes unnoticed by its callers; and its index can mix up two processes that fill it at once. Here
every compiled signature is one file whose name is a digest of all that it depends on, written whole.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import platform
import tempfile
from collections.abc import Callable
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
from numba.core import caching, compiler, serialize, sigutils

from codecbench.core.kernels.cache_folder import cache_folder
from codecbench.core.kernels.source import SourceError

# numba is typed in part and differently in each version; what it does is checked by the tests of this module.
_settings: Any = numba.config
_serialize: Any = serialize
_result: Any = compiler.CompileResult
_arguments: Any = sigutils.normalize_signature

_DIGEST_BYTES = 32


class KernelCache(caching._Cache):  # type: ignore[misc,unused-ignore]
    """The cache of one build of one kernel, in the form that a numba dispatcher uses.

    name: for people who look into the folder. fingerprint: gives a digest of everything that the source depends on;
    asked once, when the first signature is wanted and all that the source names is defined. Where there is no source
    to go by (typed at a prompt, edited since it was imported), nothing is kept. A folder that cannot be written to
    costs compile time, nothing else.
    """

    def __init__(self, name: str, fingerprint: Callable[[], str]) -> None:
        self._name = "".join(letter for letter in name if letter.isalnum() or letter in "._-")
        self._compute = fingerprint

    @cached_property
    def _fingerprint(self) -> str | None:
        try:
            return self._compute()
        except SourceError:
            return None

    @property
    def cache_path(self) -> str:
        return str(cache_folder() / "kernels")

    def _file(self, signature: Any, codegen: Any) -> Path | None:
        if self._fingerprint is None:
            return None
        arguments, result = _arguments(signature)
        versions = (numba.__version__, version("llvmlite"), platform.python_version(), platform.machine())
        settings = (_settings.OPT, _settings.BOUNDSCHECK, _settings.LOOP_VECTORIZE)
        key = (self._fingerprint, arguments, result, codegen.magic_tuple(), versions, settings)
        return Path(self.cache_path) / f"{self._name}-{hashlib.sha256(repr(key).encode()).hexdigest()[:24]}.bin"

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The compiled signature, or None where it is not there, damaged or made by other versions."""
        target_context.refresh()
        file = self._file(sig, target_context.codegen())
        if file is None:
            return None
        try:
            content = file.read_bytes()
        except OSError:
            return None
        digest, payload = content[:_DIGEST_BYTES], content[_DIGEST_BYTES:]
        if hashlib.sha256(payload).digest() != digest:
            return None
        return _result._rebuild(target_context, *pickle.loads(payload))

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled signature, unless its code holds addresses of this very process."""
        if data.library.has_dynamic_globals or any(not lifted.can_cache for lifted in data.lifted):
            return
        file = self._file(sig, data.codegen)
        if file is None:
            return
        payload = _serialize.dumps(data._reduce())
        try:
            file.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as unfinished:
                unfinished.write(hashlib.sha256(payload).digest() + payload)
            os.replace(unfinished.name, file)
        except OSError:
            return

    def enable(self) -> None:
        """Nothing to do: the cache is always on."""

    def disable(self) -> None:
        """Nothing to do: the cache is always on."""

    def flush(self) -> None:
        """Nothing to do: an entry can never be out of date."""
