"""Confine other distributions' code with Linux namespaces: no network, no data, no privileges.

Confinement is off unless `CODECBENCH_CONFINE` is set, as `codecbench --confine` does. Hosts, which import such code,
then see installed packages and a temporary folder of their own, the only one that they can write to. They see no
network and no other processes, and have no capabilities. `supervisor` implements it.
"""

from __future__ import annotations

import functools
import json
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Sequence
from typing import Any, Final

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.held_folder import HeldFolder

VARIABLE: Final = "CODECBENCH_CONFINE"
"""Environment variable that requests confinement: any value but empty or 0."""

_SUPERVISOR: Final = os.path.join(os.path.dirname(os.path.abspath(__file__)), "supervisor.py")
_PATIENCE_S: Final = 20.0


def is_confinement_requested() -> bool:
    """Whether code of other distributions is to be confined."""
    return os.environ.get(VARIABLE, "") not in ("", "0")


@functools.cache
def confinement() -> str:
    """Describe the confinement available here. Raises CodecbenchError if the system does not allow it."""
    if sys.platform != "linux":
        raise _confinement_error(f"{platform.system()} has no namespaces, Linux has")
    with HeldFolder("codecbench-trial-") as held:
        command = supervisor_command("os:getpid", folder=str(held.path), confines=True)
        try:
            process = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise _confinement_error(str(error)) from error
    if process.returncode != 0:
        reason = " ".join(process.stderr.split()[-40:]) or f"exit status {process.returncode}"
        raise _confinement_error(f"the system forbids it: {reason}")
    from codecbench.core.engine.hosting.supervisor import USER  # loads ctypes, which slows `codecbench list`

    return f"namespaces, user {USER}"


def supervisor_command(
    function: str,
    *arguments: Any,
    folder: str,
    confines: bool,
    descriptors: Sequence[int] = (),
    dies: bool = False,
    shows: Iterable[str] = (),
) -> list[str]:
    """Return the command of a supervised process that calls a function `module:name` with arguments of JSON types.

    folder: for its temporary files. confines: it sees the paths in `shows`, read-only, but no other data. descriptors:
    its own, which its supervisor closes. dies: it ends with the thread that starts it.
    """
    shown = [*map(str, shows), *_code_elsewhere()] if confines else None
    paths = [os.path.abspath(path) for path in sys.path]
    request = json.dumps([paths, dies, shown, descriptors, folder, function, arguments])
    return [sys.executable, "-P", _SUPERVISOR, request]


def paths_in(arguments: Sequence[Any]) -> set[str]:
    """Return the paths in a question about a dataset.

    They are in its parameters, relative to the folder that follows, or arguments of their own.
    """
    index = next((place for place, argument in enumerate(arguments) if isinstance(argument, dict)), None)
    if index is None:
        return {argument for argument in arguments if isinstance(argument, str) and os.path.isabs(argument)}
    folder = str(next((argument for argument in arguments[index + 1 :] if isinstance(argument, str)), ""))
    texts = (os.path.expanduser(os.path.expandvars(text)) for text in _texts(arguments[index]))
    paths = {os.path.join(folder, text) for text in texts if text and "\0" not in text}
    return {path for path in paths if os.path.isabs(path) and os.path.exists(path)}


def _texts(value: Any) -> Iterable[str]:
    if isinstance(value, str | os.PathLike):
        yield os.fspath(value)
    for part in value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ():
        yield from _texts(part)


def _code_elsewhere() -> Iterable[str]:
    """Yield code that hosts run from outside `sys.path`: compiled kernels, and editable packages."""
    from codecbench.core.kernels.folders import kernel_folder, precompiled_folders  # unused unless hosts are confined

    yield from (str(folder) for folder in (kernel_folder(), *precompiled_folders()) if folder is not None)
    finders = [module for name, module in sys.modules.items() if name.startswith("__editable__")]
    yield from (str(path) for finder in finders for path in getattr(finder, "MAPPING", {}).values())


def _confinement_error(reason: str) -> CodecbenchError:
    """Return an error whose cause is the machine and not the user."""
    error = CodecbenchError(
        f"plugins cannot be confined on {platform.node()}: {reason}; confinement needs Linux 5.12 and user namespaces "
        "(sysctl user.max_user_namespaces above 0; if they exist, kernel.unprivileged_userns_clone=1 and "
        f"kernel.apparmor_restrict_unprivileged_userns=0): enable them, or leave out --confine and {VARIABLE}"
    )
    error.__cause__ = OSError(reason)
    return error
