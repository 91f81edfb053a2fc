"""Functions compiled by numba and found again on disk.

    @compiled
    def halve(values):
        for i in range(values.size):
            values[i] *= 0.5

A compiled function is a numba dispatcher, called as any function. Each signature is compiled once on a machine and
kept under a name that covers the function, the constants it reads and the functions it calls, in whatever file they
stand; an edit of any of them is compiled anew, without anything to clear.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from types import FunctionType
from typing import Any, Final, TypeVar, overload

import numba
from numba.core.dispatcher import Dispatcher

from codecbench.core.kernels.cache import Build, CompileOnce, KernelCache
from codecbench.core.kernels.source import fingerprint

F = TypeVar("F", bound=Callable[..., Any])

UNCALLED: Final[dict[str, Any]] = {"no_cfunc_wrapper": True}
"""Options of numba that leave out what it makes for callers in C, a tenth of the time: there are none."""


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
