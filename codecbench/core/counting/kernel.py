"""Kernels: plain Python functions on arrays, with a fast build and a counting build of one source.

    @kernel
    def quantise(coefficients, steps, levels):
        for i in range(coefficients.size):
            levels[i] = int(coefficients[i] / steps[i])

The fast build is the function compiled by numba. The counting build is the same syntax tree with counters added (see
`rewriting`). Kernels may call kernels, whose operations count too; numba functions may call kernels. The language is
numbers, array elements, `range` loops and the functions in `operations`.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import inspect
from collections.abc import Callable
from functools import cached_property
from types import FunctionType
from typing import Any, Literal, overload

import numba
from numba.core import types

from codecbench.core.counting import checking, expressions, operations, rewriting
from codecbench.core.counting.checking import CountingCompiler, count_and_return
from codecbench.core.counting.expressions import COUNTED, UncountableError
from codecbench.core.counting.operations import new_counters
from codecbench.core.counting.rewriting import counting_tree
from codecbench.core.kernels.compiled import UNCALLED, compiled, use_disk_cache
from codecbench.core.kernels.source import function_tree


class Kernel:
    """A kernel: calling it runs the fast build."""

    def __init__(self, function: FunctionType, options: dict[str, Any]) -> None:
        if not isinstance(function, FunctionType):
            raise TypeError(f"@kernel needs a plain function, got {function!r}")
        functools.update_wrapper(self, function)
        self.python = self.py_func = function
        """The function as written; numba dispatchers call it `py_func`."""
        self.options = options
        """numba's options for both builds."""

    def __call__(self, *arguments: Any) -> Any:
        return self.fast(*arguments)

    def __repr__(self) -> str:
        return f"<kernel {self.python.__module__}.{self.python.__qualname__}>"

    def __reduce__(self) -> str:
        return self.python.__qualname__

    @property
    def _numba_type_(self) -> Any:
        """The type that numba sees inside other compiled functions: that of the fast build."""
        return types.Dispatcher(self.fast)

    @cached_property
    def fast(self) -> Any:
        """The numba dispatcher of the fast build, compiled at its first call and cached on disk."""
        return compiled(**self.options)(self.python)

    def dispatcher(self, build: Literal["fast", "counting"]) -> Any:
        """Return the numba dispatcher of a build."""
        return self.fast if build == "fast" else self.counting_build

    @cached_property
    def counting_build(self) -> Any:
        """The numba dispatcher of the counting build, which takes int64 counters before the arguments.

        It returns what the kernel returns, and adds its operations to the counters. Raises UncountableError if the
        source goes beyond the language of kernels.
        """
        function, callees = self._counting_function()
        dispatcher = numba.njit(pipeline_class=CountingCompiler, **UNCALLED, **self.options)(function)
        for name, callee in callees.items():
            function.__globals__[name] = dispatcher if callee is self else callee.counting_build
        return use_disk_cache(dispatcher, self.python, self.options, "counting", _rewriting_digest())

    def _counting_function(self) -> tuple[FunctionType, dict[str, Any]]:
        tree, callees = counting_tree(function_tree(self.python), self.python)
        namespace = {**self.python.__globals__, COUNTED: count_and_return}
        exec(compile(ast.Module([tree], []), self.python.__code__.co_filename, "exec", dont_inherit=True), namespace)
        function = namespace[tree.name]
        function.__defaults__ = self.python.__defaults__
        function.__qualname__ = f"{self.python.__qualname__}__counting"
        return function, callees


@functools.cache
def _rewriting_digest() -> str:
    """Return a digest of the code that turns a tree into its counting build, so that every change of it counts."""
    sources = [inspect.getsource(module) for module in (rewriting, expressions, operations, checking)]
    return hashlib.sha256("".join(sources).encode()).hexdigest()


@overload
def kernel(function: Callable[..., Any], /) -> Kernel: ...


@overload
def kernel(**options: Any) -> Callable[[Callable[..., Any]], Kernel]: ...


def kernel(function: Callable[..., Any] | None = None, /, **options: Any) -> Any:
    """Make a function a kernel; `options` go to numba for both builds (`error_model="numpy"`)."""
    if function is None:
        return functools.partial(kernel, **options)
    return Kernel(function, options)  # type: ignore[arg-type]


__all__ = ["Kernel", "UncountableError", "kernel", "new_counters"]
