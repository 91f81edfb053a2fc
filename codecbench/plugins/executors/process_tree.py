"""A worker with all that it started: whether it runs, what memory it takes, its end."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path

import psutil


def kill_tree(pid: int) -> None:
    """Kill a worker, its process group and whatever left the group."""
    descendants: list[psutil.Process] = []
    with suppress(psutil.NoSuchProcess):
        descendants = psutil.Process(pid).children(recursive=True)
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)
    for process in descendants:
        with suppress(psutil.NoSuchProcess):
            process.kill()


def runs(pid: int) -> bool:
    """Whether the process still runs. One whose parent died stays a zombie where the first process reaps none.

    That is so in a container whose command is its first process.
    """
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def tree_mb(pid: int) -> float:
    """Memory of a worker and its descendants; a page that they share is counted once a process."""
    return private_mb(pid) + sum(map(tree_mb, _children(pid)))


def _children(pid: int) -> list[int]:
    """Children of a process; on a system that does not list them, psutil reads all processes, which takes longer."""
    try:
        lists = [(task / "children").read_text(encoding="ascii") for task in Path(f"/proc/{pid}/task").iterdir()]
        return [int(child) for children in lists for child in children.split()]
    except OSError:
        with suppress(psutil.NoSuchProcess):
            return [child.pid for child in psutil.Process(pid).children()]
        return []


def private_mb(pid: int) -> float:
    """Anonymous and shared memory of a process in MB, without the pages of files it maps; 0 if it is gone."""
    total_kb = 0
    with suppress(OSError), open(f"/proc/{pid}/status", encoding="ascii", errors="replace") as status:
        for line in status:
            if line.startswith(("RssAnon:", "RssShmem:")):
                total_kb += int(line.split()[1])
    return total_kb / 1024
