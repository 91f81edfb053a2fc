"""Kernels: plain Python functions on arrays with a fast build and a counting build of one source."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba


def kernel(function: Callable[..., Any]) -> Any:
    """Compile a function of arrays and scalars."""
    return numba.njit(cache=True)(function)
