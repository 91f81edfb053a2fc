"""Confinement of other distributions' code by bubblewrap: no network, and no file written outside one folder.

It is off unless `CODECBENCH_CONFINE` is set, which `codecbench --confine` does. Then the hosts, which import such
code, see the file system as it is, but can write to their own folder of temporary files alone; have a
network without a way out; see no process but their own; and have no capabilities. What is below /run, where sockets of
services are, is not there for them.
"""

from __future__ import annotations

import functools
import os
import platform
import shutil
import subprocess
from typing import Final

from codecbench.core.contracts.errors import CodecbenchError

VARIABLE: Final = "CODECBENCH_CONFINE"
"""The environment variable that asks for confinement: anything but empty or 0."""

_TOOL: Final = "bwrap"
_WORDS: Final = (
    "--ro-bind", "/", "/",
    "--dev", "/dev",
    "--proc", "/proc",
    "--tmpfs", "/run",
    "--unshare-net", "--unshare-pid", "--unshare-ipc",
    "--cap-drop", "ALL",
    "--new-session", "--die-with-parent",
)  # fmt: skip
_PATIENCE_S: Final = 20.0


def wanted() -> bool:
    """Whether code of other distributions is to be confined."""
    return os.environ.get(VARIABLE, "") not in ("", "0")


@functools.cache
def confinement() -> str:
    """The tool that confines here, with its version. Raises CodecbenchError where the system does not allow it."""
    tool = _tool()
    tried = _called(tool, *_WORDS, "true")
    if tried.returncode != 0:
        said = " ".join(tried.stderr.split()) or f"exit status {tried.returncode}"
        raise _not_possible(f"the system does not let it: {said}")
    return " ".join(["bubblewrap", *_called(tool, "--version").stdout.split()[1:2]])


def confining_words(folder: str) -> list[str]:
    """The words before a command that confine it, so that it can write to `folder` and nowhere else.

    Raises CodecbenchError where the system does not allow it.
    """
    confinement()
    return [_tool(), *_WORDS, "--bind", folder, folder, "--"]


def status_inside(status: int) -> int:
    """The exit status of a confined command from that of the words before it: negative for the signal it died of."""
    return 128 - status if status > 128 else status


def _tool() -> str:
    tool = shutil.which(_TOOL)
    if tool is None:
        raise _not_possible(f"{_TOOL} is not on the PATH")
    return tool


def _called(*words: str) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(words, capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise _not_possible(str(error)) from error


def _not_possible(reason: str) -> CodecbenchError:
    """The error, of the kind that is the machine's and not the user's."""
    error = CodecbenchError(
        f"plugins cannot be confined on {platform.node()}: {reason}; confinement needs bubblewrap and permission to "
        f"make user namespaces: install its package, have them allowed, or leave out --confine and {VARIABLE}"
    )
    error.__cause__ = OSError(reason)
    return error
