"""Functions that numba compiles and a disk cache stores.

    @compiled
    def halve(values):
        for i in range(values.size):
            values[i] *= 0.5

A compiled function is a numba dispatcher, called as any function. Each signature is compiled once on a machine. Its
cache key covers the function, the constants that it reads and the functions that it calls, in whatever file: an edit of
any of them is compiled again, and no cache has to be cleared.

numba compiles for a level of x86-64, not for the processor at hand, so that one machine's code serves all others. A
user's `NUMBA_CPU_NAME` or `NUMBA_CPU_FEATURES` takes precedence, and other architectures use numba's default.
"""

from __future__ import annotations

import functools
import platform
from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any, Final, TypeVar, overload

import numba
from llvmlite import binding  # type: ignore[import-untyped]
from numba.core.dispatcher import Dispatcher

from codecbench.core.kernels.cache import Build, CompileOnce, KernelCache
from codecbench.core.kernels.source import fingerprint

F = TypeVar("F", bound=Callable[..., Any])

UNCALLED: Final[dict[str, Any]] = {"no_cfunc_wrapper": True}
"""numba options that leave out the wrapper for C callers, a tenth of the compile time: there are none."""

LEVELS: Final = {
    "x86-64-v3": ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"),
    "x86-64-v2": ("cx16", "popcnt", "sahf", "sse3", "ssse3", "sse4.1", "sse4.2"),
}
"""Levels of x86-64, newest first, each with the features that it adds to the level below."""


def level_of(features: Mapping[str, bool]) -> str | None:
    """Return the newest level that a processor with these features supports; None if it supports none."""
    newest = None
    for name in reversed(LEVELS):
        if not all(features.get(feature, False) for feature in LEVELS[name]):
            break
        newest = name
    return newest


def _compile_for_level() -> None:
    """Make numba compile for this processor's level; it reads the settings when it creates the first dispatcher."""
    settings: Any = numba.config
    if platform.machine() != "x86_64" or settings.CPU_NAME is not None or settings.CPU_FEATURES is not None:
        return
    level = level_of(binding.get_host_cpu_features())
    if level is not None:
        settings.CPU_NAME, settings.CPU_FEATURES = level, ""


_compile_for_level()


@overload
def compiled(function: F, /) -> F: ...


@overload
def compiled(**options: Any) -> Callable[[F], F]: ...


def compiled(function: Any = None, /, **options: Any) -> Any:
    """Compile a plain function at its first call; `options` go to numba (`inline="always"`, `error_model="numpy"`)."""
    if function is None:
        return functools.partial(compiled, **options)
    return use_disk_cache(numba.njit(**UNCALLED, **options)(function), function, options, "fast")


def use_disk_cache(
    dispatcher: Any, function: FunctionType, options: dict[str, Any], build: Build, rules: str = ""
) -> Any:
    """Make a dispatcher store its signatures in the disk cache, and return it.

    function: the source of the build. rules: a digest of the code that turned the source into a build other than
    `fast`.
    """
    if isinstance(dispatcher, Dispatcher):  # not if NUMBA_DISABLE_JIT is set
        cached: Any = dispatcher
        name = f"{function.__module__}:{function.__qualname__}"
        cached._cache = KernelCache(name, build, lambda: f"{build}{rules}:{fingerprint(function, options)}")
        cached._compiler = CompileOnce(cached._compiler, cached._cache, cached.targetctx)
    return dispatcher
