"""The errors that codecbench raises on purpose.

Each says what is wrong, where, what was got, what is allowed and what to do next. Anything else that
escapes from a plugin is a fault of that plugin and becomes the reason of its cell.
"""

from __future__ import annotations

import json
from typing import Any, get_args


class CodecbenchError(Exception):
    """Every error that codecbench raises on purpose is one of these."""


class ImageError(CodecbenchError, ValueError):
    """An image has a shape, dtype or layout that the contract or this codec does not take."""


class BitstreamError(CodecbenchError, ValueError):
    """A bitstream is damaged, truncated, foreign or asks for more than the decoder allows."""


class ParamsError(CodecbenchError, ValueError):
    """Parameters contradict each other or are outside their range."""


class KeyCollision(ParamsError):
    """Two tuples of digits get the same code under the given keys, so decoding could not tell them apart."""


class DatasetError(CodecbenchError):
    """A sequence on disk is missing, damaged or inconsistent; the message names the file and line.

    what: the message. without: parameters of its dataset, as JSON types, that open the rest, which its text says.
    """

    def __init__(self, what: str = "", without: dict[str, Any] | None = None) -> None:
        super().__init__(what)
        self.what = what
        self.without = without or {}

    @property
    def settings(self) -> str:
        """What opens the rest as a matrix has it, such as `skip: [4]`; empty where nothing does."""
        values = {name: value if isinstance(value, str) else json.dumps(value) for name, value in self.without.items()}
        return ", ".join(f"`{name}: {value}`" for name, value in values.items())

    def __str__(self) -> str:
        said = not self.settings or self.settings in self.what
        return self.what if said else f"{self.what}; set {self.settings} to go without it"


class MatrixError(CodecbenchError):
    """A matrix file is wrong; the message lists every problem, each with file, line and column."""


class PluginError(CodecbenchError):
    """A plugin is unknown, failed to import or breaks the contract."""


def require_choice(what: str, got: object, choices: Any) -> None:
    """Raise PluginError where something is none of the choices of a Literal."""
    if got not in get_args(choices):
        raise PluginError(f"{what} is {got!r}; it is one of {', '.join(get_args(choices))}")


class StoreError(CodecbenchError):
    """A run folder is locked, damaged or was written by an incompatible version."""


class SlamError(CodecbenchError):
    """A SLAM backend was given something that it cannot run on."""


class Unsupported(CodecbenchError):
    """This combination cannot be computed here; it becomes a row with status `unsupported` and this reason.

    Raise it where a library, a system tool or a property of the sequence is missing. Say what is missing
    and the command that provides it.
    """
