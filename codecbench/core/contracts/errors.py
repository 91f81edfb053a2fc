"""The errors that codecbench raises on purpose, and the warnings of renamed fields.

Each message says what is wrong, where, what is allowed and what to do next. Any other exception from a plugin is a
fault of that plugin and becomes the reason of its cell.
"""

from __future__ import annotations

import functools
import json
import warnings
from collections.abc import Callable
from typing import Any, TypeVar, get_args

T = TypeVar("T")


class CodecbenchError(Exception):
    """Base of every error that codecbench raises on purpose."""


class ImageError(CodecbenchError, ValueError):
    """An image has a shape, dtype or layout that the contract or this codec does not allow."""


class BitstreamError(CodecbenchError, ValueError):
    """A bitstream is damaged, truncated, foreign or asks for more than the decoder allows."""


class ParamsError(CodecbenchError, ValueError):
    """Parameters contradict each other or are outside their range."""


class KeyCollision(ParamsError):
    """Two tuples of digits get the same code under the given keys, so decoding could not tell them apart."""


class DatasetError(CodecbenchError):
    """A sequence on disk is missing, damaged or inconsistent; the message names the file and line."""

    def __init__(self, what: str = "", without: dict[str, Any] | None = None) -> None:
        """`without`: parameters of its dataset, as JSON types, that open the undamaged rest; the text suggests them."""
        super().__init__(what)
        self.what = what
        self.without = without or {}

    @property
    def settings(self) -> str:
        """The parameters that open the rest, spelled as in a matrix, such as `skip: [4]`; empty for none."""
        values = {name: value if isinstance(value, str) else json.dumps(value) for name, value in self.without.items()}
        return ", ".join(f"`{name}: {value}`" for name, value in values.items())

    def __str__(self) -> str:
        complete = not self.settings or self.settings in self.what
        return self.what if complete else f"{self.what}; set {self.settings} to go without it"


class MatrixError(CodecbenchError):
    """A matrix file is wrong; the message lists every problem, each with file, line and column."""


class PluginError(CodecbenchError):
    """A plugin is unknown, failed to import or breaks the contract."""


def require_choice(what: str, got: object, choices: Any) -> None:
    """Raise PluginError if a value is none of the choices of a Literal."""
    if got not in get_args(choices):
        raise PluginError(f"{what} is {got!r}; it must be one of {', '.join(get_args(choices))}")


class StoreError(CodecbenchError):
    """A run folder is locked, damaged or was written by an incompatible version."""


class SlamError(CodecbenchError):
    """A SLAM backend was given something that it cannot run on."""


class Unsupported(CodecbenchError):
    """This combination cannot be computed here; it becomes a row with status `unsupported` and this reason.

    Raise it if a library, a system tool or a property of the sequence is missing. Say what is missing and which command
    provides it.
    """


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
