"""pytest support: benchmarks of codecs, their baseline, and the conformance checks as a test class.

`CodecSuite` is loaded at its first use, because every pytest run in an environment with codecbench imports this package
for its plugin.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from codecbench.pytesting.suite import CodecSuite

__all__ = ["CodecSuite"]

ALL: Final = "*"
"""The value of `--codecbench` that names every installed codec."""


def __getattr__(name: str) -> Any:
    if name != "CodecSuite":
        raise AttributeError(f"module 'codecbench.pytesting' has no attribute {name!r}")
    from codecbench.pytesting.suite import CodecSuite

    return CodecSuite
