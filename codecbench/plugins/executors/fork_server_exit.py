"""Removes the fork server's socket when the server ends; only the server imports this module.

The program removes the folder of the socket itself, unless it is killed; the server ends either way. Forks of the
server exit with `os._exit`, which skips what is registered here. Processes that the program spawns, such as workers of
dask, put the sockets of their own servers into the same folder, so each server removes only its own.
"""

from __future__ import annotations

import atexit
import multiprocessing.forkserver
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

_PREFIX: Final = "pymp-"
"""Prefix of the folders that multiprocessing makes for sockets."""


def remove_socket() -> None:
    """Remove this server's socket, and its folder if that is then empty."""
    server: Any = getattr(multiprocessing.forkserver, "_forkserver", None)
    with suppress(AttributeError, TypeError, OSError):
        address = Path(server._forkserver_address)
        if address.parent.name.startswith(_PREFIX):
            address.unlink(missing_ok=True)
            address.parent.rmdir()


atexit.register(remove_socket)
