"""A process and its descendants: whether it runs, how much memory they use, and how to kill them."""

from __future__ import annotations

import os
import signal
from contextlib import suppress
from pathlib import Path

import psutil


def kill_tree(pid: int) -> None:
    """Kill a worker, its process group, and descendants that left the group."""
    descendants: list[psutil.Process] = []
    with suppress(psutil.NoSuchProcess):
        descendants = psutil.Process(pid).children(recursive=True)
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)
    for process in descendants:
        with suppress(psutil.NoSuchProcess):
            process.kill()


def is_running(pid: int) -> bool:
    """Whether the process still runs. A zombie does not.

    A process whose parent died stays a zombie in a container whose first process, its command, reaps none.
    """
    try:
        return bool(psutil.Process(pid).status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False


def tree_mb(pid: int) -> float:
    """Memory of a worker and its descendants in MB; a shared page is counted once for each process."""
    return private_mb(pid) + sum(map(tree_mb, _children(pid)))


def _children(pid: int) -> list[int]:
    """Process ids of the children. If the system does not list them, psutil reads all processes, which takes longer."""
    try:
        lists = [(task / "children").read_text(encoding="ascii") for task in Path(f"/proc/{pid}/task").iterdir()]
        return [int(child) for children in lists for child in children.split()]
    except OSError:
        with suppress(psutil.NoSuchProcess):
            return [child.pid for child in psutil.Process(pid).children()]
        return []


def private_mb(pid: int) -> float:
    """Anonymous and shared memory of a process in MB, without mapped files; 0 if it has ended."""
    total_kb = 0
    with suppress(OSError), open(f"/proc/{pid}/status", encoding="ascii", errors="replace") as status:
        for line in status:
            if line.startswith(("RssAnon:", "RssShmem:")):
                total_kb += int(line.split()[1])
    return total_kb / 1024
