"""The lock of a run folder, which one process holds while it writes.

It is a system lock (flock): it ends with its process, however that ends, and cannot go stale.
"""

from __future__ import annotations

import fcntl
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.storage.plain_file import open_plain
from codecbench.core.engine.text import clean_line


@contextmanager
def hold_lock(file: Path) -> Iterator[None]:
    """Hold the lock and write the holder into its file. Raises OSError, and StoreError if another process holds it."""
    with open(file, "a+", encoding="utf-8", errors="replace") as stream:
        if not _try_lock(stream):
            stream.seek(0)
            holder = clean_line(stream.read(1000).strip()) or "another process"
            message = f"{file.parent} is in use by {holder}; wait for it to end or choose another folder with --out"
            raise StoreError(message)
        stream.truncate(0)
        os.write(stream.fileno(), f"process {os.getpid()} on {socket.gethostname()}".encode())
        yield


def is_locked(file: Path) -> bool:
    """Whether a process holds the lock now."""
    try:
        with open_plain(file) as stream:
            fcntl.flock(stream, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    return False


def _try_lock(stream: TextIO) -> bool:
    """Lock an open file exclusively; retries briefly, because `is_locked` may hold it for a moment."""
    for _ in range(4):
        with suppress(BlockingIOError):
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        time.sleep(0.05)
    return False
