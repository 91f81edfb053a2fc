"""Imported by the fork server alone: when it ends, its socket goes with it, and the folder of that if it was the last.

The program removes that folder itself unless it is killed; the server ends either way. Its forks leave by `os._exit`,
which calls nothing that is registered here. Processes that the program spawns, as workers of dask are, put the sockets
of their own servers into the same folder, so that each server may remove its own alone.
"""

from __future__ import annotations

import atexit
import multiprocessing.forkserver
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

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


atexit.register(remove_socket)
