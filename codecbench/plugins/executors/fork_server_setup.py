"""Imported by the fork server alone: numba is ready for a first kernel, and the server's socket goes with it.

So does the folder of the socket if it was the last thing in it. The program removes that folder itself unless it is
killed; the server ends either way. Its forks leave by `os._exit`, which calls nothing that is registered here.
Processes that the program spawns, as workers of dask are, put the sockets of their own servers into the same folder,
so that each server may remove its own alone.
"""

from __future__ import annotations

import atexit
import multiprocessing.forkserver
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from numba.core.registry import cpu_target

import codecbench.core.kernels.compiled  # noqa: F401 - it says which processor numba compiles for, before numba asks

_PREFIX: Final = "pymp-"
"""Of the folders that multiprocessing makes for sockets."""


def remove_socket() -> None:
    """Remove this server's socket, and the folder where it was the last thing in it."""
    server: Any = getattr(multiprocessing.forkserver, "_forkserver", None)
    with suppress(AttributeError, TypeError, OSError):
        address = Path(server._forkserver_address)
        if address.parent.name.startswith(_PREFIX):
            address.unlink(missing_ok=True)
            address.parent.rmdir()


cpu_target.target_context.refresh()  # 0.3 s, that each fork would need for its first kernel
atexit.register(remove_socket)
