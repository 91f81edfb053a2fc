"""Importing this module has numba load all that it would load before it compiles or takes a kernel from the cache.

That takes most of a second of processor time, once for all processes that are forked from one that has imported it.
"""

from numba.core.registry import cpu_target

from codecbench.core.kernels import compiled  # noqa: F401 - which decides for which processor numba compiles

cpu_target.typing_context.refresh()
cpu_target.target_context.refresh()
