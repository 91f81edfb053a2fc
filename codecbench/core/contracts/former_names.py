"""Deprecated names in the contracts, which still work for one version, with a warning."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

T = TypeVar("T")


def former_names(**current: str) -> Callable[[type[T]], type[T]]:
    """Let a dataclass be created and read by deprecated names of its fields, given as `former="current"`.

    `__former_names__` lists them, for reading stored records.
    """

    def decorate(cls: type[T]) -> type[T]:
        create: Any = cls.__init__

        @functools.wraps(create)
        def init(self: Any, *values: Any, **named: Any) -> None:
            for former in current.keys() & named.keys():
                _warn(cls, former, current[former])
                named[current[former]] = named.pop(former)
            create(self, *values, **named)

        for former, name in current.items():
            setattr(cls, former, _alias(cls, former, name))
        for name, value in (("__init__", init), ("__former_names__", current)):
            setattr(cls, name, value)
        return cls

    return decorate


def _alias(cls: type[Any], former: str, name: str) -> property:
    def read(self: Any) -> Any:
        _warn(cls, former, name)
        return getattr(self, name)

    return property(read, doc=f"The former name of `{name}`.")


def _warn(cls: type[Any], former: str, name: str) -> None:
    warnings.warn(f"{cls.__name__}.{former} is now called {name}", DeprecationWarning, stacklevel=3)
