"""Functions compiled by numba and found again on disk.

    @compiled
    def halve(values):
        for i in range(values.size):
            values[i] *= 0.5

A compiled function is a numba dispatcher, called as any function. Each signature is compiled once on a machine and
kept under a name that covers the function, the constants it reads and the functions it calls, in whatever file they
stand; an edit of any of them is compiled anew, without anything to clear.

numba compiles for a level of x86-64 and not for the processor that it runs on, so that what one machine compiles serves
all others. A user's `NUMBA_CPU_NAME` or `NUMBA_CPU_FEATURES` decides instead, and other architectures keep numba's way.
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
"""Options of numba that leave out what it makes for callers in C, a tenth of the time: there are none."""

LEVELS: Final = {
    "x86-64-v3": ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"),
    "x86-64-v2": ("cx16", "popcnt", "sahf", "sse3", "ssse3", "sse4.1", "sse4.2"),
}
"""Levels of x86-64 from the newest, with what a processor must have beside what the level below it takes."""


def level_of(features: Mapping[str, bool]) -> str | None:
    """The newest level that a processor with these features has; None where it has none of them."""
    newest = None
    for name in reversed(LEVELS):
        if not all(features.get(feature, False) for feature in LEVELS[name]):
            break
        newest = name
    return newest


def _compile_for_level() -> None:
    """Have numba compile for the level of this processor; it asks before it makes the first dispatcher."""
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
    return kept(numba.njit(**UNCALLED, **options)(function), function, options, "fast")


def kept(dispatcher: Any, function: FunctionType, options: dict[str, Any], build: Build, rules: str = "") -> Any:
    """The dispatcher, with its signatures kept on disk.

    function: the source that it stands for. build: `fast`, or what else was made of that source by `rules`, a digest
    of whatever turned the source into the build.
    """
    if isinstance(dispatcher, Dispatcher):  # not where NUMBA_DISABLE_JIT is set
        made: Any = dispatcher
        name = f"{function.__module__}:{function.__qualname__}"
        made._cache = KernelCache(name, build, lambda: f"{build}{rules}:{fingerprint(function, options)}")
        made._compiler = CompileOnce(made._compiler, made._cache, made.targetctx)
    return dispatcher
