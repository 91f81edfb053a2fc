"""Where a codec's operations are counted: a trace has stages, and a stage runs kernels.

    with trace.stage("dct") as run:
        run(forward_dct, plane, coefficients)

Under NULL_TRACE `run` calls the kernel's fast build and nothing is counted. Under a CountingTrace it calls
the counting build of the same source and adds what was counted to the stage. Both give the same arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from codecbench.core.counting.operations import OperationCounts

Run: TypeAlias = Callable[..., Any]
"""`run(kernel, *arguments)` returns what the kernel returns."""


class Trace(Protocol):
    """Something that kernels are run under."""

    def stage(self, name: str) -> Any:
        """A context manager that gives the `run` of one stage; stages may recur and then add up."""
        ...


def _run_fast(kernel: Any, *arguments: Any) -> Any:
    return kernel(*arguments)


class _NullTrace:
    _STAGE = nullcontext(_run_fast)

    def stage(self, name: str) -> nullcontext[Run]:
        return self._STAGE


NULL_TRACE: Trace = _NullTrace()
"""Counts nothing and costs nothing: what every codec runs under unless it is being counted."""


class CountingTrace:
    """Counts the operations of every kernel that is run under it.

    A kernel counts where it is run: a stage inside another keeps its own counts, so that the sum over all
    stages is the whole work, and a stage that comes again goes on counting.
    """

    def __init__(self) -> None:
        self._counters: dict[str, NDArray[Any]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[Run]:
        """Give the `run` that counts into the stage `name`; it raises TypeError for what is no kernel."""
        from codecbench.core.counting.operations import new_counters  # numpy, not needed to declare a codec

        counters = self._counters.setdefault(name, new_counters())

        def run(kernel: Any, *arguments: Any) -> Any:
            if not hasattr(type(kernel), "counting_build"):
                raise TypeError(f"stage {name!r} was given {kernel!r} to run; only a @kernel can be counted")
            return kernel.counting_build(counters, *arguments)

        yield run

    @property
    def counts(self) -> dict[str, OperationCounts]:
        """What was counted so far, by stage, in the order in which the stages were first entered."""
        from codecbench.core.counting.operations import OperationCounts

        return {name: OperationCounts.from_counters(counters) for name, counters in self._counters.items()}
