"""Confinement of other distributions' code by Linux namespaces: no network, no data, no privileges.

It is off unless `CODECBENCH_CONFINE` is set, which `codecbench --confine` does. Then the hosts, which import such
code, see installed packages and their own folder of temporary files, which alone they can write to; see no network
and no process but their own; and have no capabilities. `supervisor` does that.
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
"""The environment variable that asks for confinement: anything but empty or 0."""

_SUPERVISOR: Final = os.path.join(os.path.dirname(os.path.abspath(__file__)), "supervisor.py")
_PATIENCE_S: Final = 20.0


def is_confinement_requested() -> bool:
    """Whether code of other distributions is to be confined."""
    return os.environ.get(VARIABLE, "") not in ("", "0")


@functools.cache
def confinement() -> str:
    """What confines here, in words. Raises CodecbenchError where the system does not allow it."""
    if sys.platform != "linux":
        raise _confinement_error(f"{platform.system()} has no namespaces, Linux has")
    with HeldFolder("codecbench-trial-") as held:
        words = supervisor_command("os:getpid", folder=str(held.path), confines=True)
        try:
            tried = subprocess.run(words, capture_output=True, text=True, timeout=_PATIENCE_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise _confinement_error(str(error)) from error
    if tried.returncode != 0:
        said = " ".join(tried.stderr.split()[-40:]) or f"exit status {tried.returncode}"
        raise _confinement_error(f"the system does not let it: {said}")
    from codecbench.core.engine.hosting.supervisor import USER  # with ctypes, for which `codecbench list` need not wait

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
    """The command of a process that calls a function, `module:name`, with arguments of JSON types; it has a supervisor.

    folder: of its temporary files. confines: it sees the paths in `shows`, read-only, but no other data. descriptors:
    its own, which its supervisor closes. dies: it ends with the thread that starts it.
    """
    shown = [*map(str, shows), *_code_elsewhere()] if confines else None
    paths = [os.path.abspath(path) for path in sys.path]
    told = json.dumps([paths, dies, shown, descriptors, folder, function, arguments])
    return [sys.executable, "-P", _SUPERVISOR, told]


def paths_in(arguments: Sequence[Any]) -> set[str]:
    """Paths that a question about a dataset names: in its parameters, from the folder told after them, or alone."""
    given = next((place for place, each in enumerate(arguments) if isinstance(each, dict)), None)
    if given is None:
        return {each for each in arguments if isinstance(each, str) and os.path.isabs(each)}
    folder = str(next((each for each in arguments[given + 1 :] if isinstance(each, str)), ""))
    texts = (os.path.expanduser(os.path.expandvars(text)) for text in _texts(arguments[given]))
    paths = {os.path.join(folder, text) for text in texts if text and "\0" not in text}
    return {path for path in paths if os.path.isabs(path) and os.path.exists(path)}


def _texts(value: Any) -> Iterable[str]:
    if isinstance(value, str | os.PathLike):
        yield os.fspath(value)
    for each in value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ():
        yield from _texts(each)


def _code_elsewhere() -> Iterable[str]:
    """What hosts run that is not on `sys.path`: compiled kernels, and packages installed in place by a finder."""
    from codecbench.core.kernels.folders import kernel_folder, precompiled_folders

    yield from (str(folder) for folder in (kernel_folder(), *precompiled_folders()) if folder is not None)
    finders = [module for name, module in sys.modules.items() if name.startswith("__editable__")]
    yield from (str(path) for finder in finders for path in getattr(finder, "MAPPING", {}).values())


def _confinement_error(reason: str) -> CodecbenchError:
    """The error, of the kind that is the machine's and not the user's."""
    error = CodecbenchError(
        f"plugins cannot be confined on {platform.node()}: {reason}; confinement needs Linux 5.12 and user namespaces "
        "(sysctl user.max_user_namespaces above 0; where they exist, kernel.unprivileged_userns_clone=1 and "
        f"kernel.apparmor_restrict_unprivileged_userns=0): have them allowed, or leave out --confine and {VARIABLE}"
    )
    error.__cause__ = OSError(reason)
    return error
