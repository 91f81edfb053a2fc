"""The errors that codecbench raises on purpose.

Each message says what is wrong, where, what is allowed and what to do next. Any other exception from a plugin is a
fault of that plugin and becomes the reason of its cell.
"""

from __future__ import annotations

import json
from typing import Any, get_args


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
        raise PluginError(f"{what} is {got!r}; it is one of {', '.join(get_args(choices))}")


class StoreError(CodecbenchError):
    """A run folder is locked, damaged or was written by an incompatible version."""


class SlamError(CodecbenchError):
    """A SLAM backend was given something that it cannot run on."""


class Unsupported(CodecbenchError):
    """This combination cannot be computed here; it becomes a row with status `unsupported` and this reason.

    Raise it if a library, a system tool or a property of the sequence is missing. Say what is missing and which command
    provides it.
    """
