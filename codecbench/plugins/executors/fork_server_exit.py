"""Imported by the fork server alone: when it ends, the folder of its socket goes with it.

The program removes that folder itself unless it is killed; the server ends either way. Its forks leave by `os._exit`,
which calls nothing that is registered here.
"""

from __future__ import annotations

import atexit
import multiprocessing.forkserver
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

_PREFIX: Final = "pymp-"
"""Of the folders that multiprocessing makes for sockets."""


def remove_socket_folder() -> None:
    """Remove the folder of this server's socket."""
    server: Any = getattr(multiprocessing.forkserver, "_forkserver", None)
    with suppress(AttributeError, TypeError):
        folder = Path(server._forkserver_address).parent
        if folder.name.startswith(_PREFIX):
            shutil.rmtree(folder, ignore_errors=True)


atexit.register(remove_socket_folder)
