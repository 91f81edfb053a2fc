"""Traces count a codec's operations: a trace has stages, and a stage runs kernels.

    with trace.stage("dct") as run:
        run(forward_dct, plane, coefficients)

Under NULL_TRACE `run` calls the kernel's fast build and counts nothing. Under a CountingTrace it calls the counting
build of the same source and adds its counts to the stage. Both return the same arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from codecbench.core.counting.operations import OperationCounts

Run: TypeAlias = Callable[..., Any]
"""`run(kernel, *arguments)` runs a kernel and returns its result."""


class Trace(Protocol):
    """The interface under which codecs run kernels."""

    def stage(self, name: str) -> Any:
        """Return a context manager for the `run` of one stage; the counts of equal names add up."""
        ...


def _run_fast(kernel: Any, *arguments: Any) -> Any:
    return kernel(*arguments)


class _NullTrace:
    _STAGE = nullcontext(_run_fast)

    def stage(self, name: str) -> nullcontext[Run]:
        return self._STAGE


NULL_TRACE: Trace = _NullTrace()
"""The default trace, which counts nothing and costs nothing."""


class CountingTrace:
    """Counts the operations of every kernel that runs under it.

    A stage inside another has its own counts, so the sum over all stages is the whole work. A stage that is entered
    again continues its counts.
    """

    def __init__(self) -> None:
        self._counters: dict[str, NDArray[Any]] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[Run]:
        """Yield the `run` that counts into the stage `name`; it raises TypeError for anything but a kernel."""
        from codecbench.core.counting.operations import new_counters  # loads numpy, not needed to declare a codec

        counters = self._counters.setdefault(name, new_counters())

        def run(kernel: Any, *arguments: Any) -> Any:
            if not hasattr(type(kernel), "counting_build"):
                raise TypeError(f"stage {name!r} was given {kernel!r} to run; only a @kernel can be counted")
            return kernel.counting_build(counters, *arguments)

        yield run

    @property
    def counts(self) -> dict[str, OperationCounts]:
        """Counts so far by stage, in the order in which the stages were first entered."""
        from codecbench.core.counting.operations import OperationCounts  # loads numpy, as above

        return {name: OperationCounts.from_counters(counters) for name, counters in self._counters.items()}
