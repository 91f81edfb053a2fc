"""Importing this module loads all of numba that compiling a kernel, or loading it from the cache, needs.

That takes most of a second of processor time, once for all processes forked from one that has imported it.
"""

from numba.core.registry import cpu_target

from codecbench.core.kernels import compiled  # noqa: F401 - it sets the processor that numba compiles for

cpu_target.typing_context.refresh()
cpu_target.target_context.refresh()
