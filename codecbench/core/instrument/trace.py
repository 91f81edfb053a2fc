"""Where a codec's operations are counted: a trace has stages, and a stage runs kernels.

    with trace.stage("dct") as run:
        run(forward_dct, plane, coefficients)

Under NULL_TRACE `run` calls the kernel's fast build and nothing is counted. Under a CountingTrace it calls
the counting build of the same source and adds what was counted to the stage. Both give the same arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, TypeAlias

Run: TypeAlias = Callable[..., Any]
"""`run(kernel, *arguments)` returns what the kernel returns."""


class Trace(Protocol):
    """Something that kernels are run under."""

    def stage(self, name: str) -> Any:
        """A context manager that gives the `run` of one stage; stages may recur and then add up."""
        ...


def _run_fast(kernel: Any, *arguments: Any) -> Any:
    return kernel(*arguments)


class _NullStage:
    def __enter__(self) -> Run:
        return _run_fast

    def __exit__(self, *_: object) -> None:
        return None


class _NullTrace:
    _STAGE = _NullStage()

    def stage(self, name: str) -> _NullStage:
        return self._STAGE


NULL_TRACE: Trace = _NullTrace()
"""Counts nothing and costs nothing: what every codec runs under unless it is being counted."""
