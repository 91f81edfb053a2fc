"""Runs the command in a process of its own, forked from one that has imported what commands need.

Imports take a command seconds, its own work mostly a tenth of that. All else is as for the installed command:
arguments, folder, environment, streams, exit status, and the processes of its plugins, which start anew. A test of the
start itself or of signals starts the installed command.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import runpy
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

COMMAND: Final = Path(sys.executable).parent / "codecbench"
_MOST_BYTES: Final = 1 << 20
_LIBRARIES: Final = (
    "cv2", "glymur", "imagecodecs", "matplotlib.figure", "numba", "pandas", "pyarrow.parquet", "pydantic",
    "rich.progress", "ruamel.yaml", "scipy.stats", "skimage.metrics",
)  # fmt: skip


def run_warm(
    words: Iterable[str | Path],
    cwd: Path,
    environment: dict[str, str],
    timeout_s: float = 300,
    most_bytes: int | None = None,
) -> subprocess.CompletedProcess[str]:
    """Run `codecbench WORDS` and return its status and text. most_bytes: limit of the size of its files.

    Modules `sitecustomize` on the PYTHONPATH of the environment are run first. Raises TimeoutExpired.
    """
    request = {"words": [*map(str, words)], "cwd": str(cwd), "environment": environment, "most_bytes": most_bytes}
    streams = [os.pipe() for _ in range(3)]
    writes = [writing for _, writing in streams]
    socket.send_fds(_server(), [json.dumps(request).encode()], writes)
    for descriptor in writes:
        os.close(descriptor)
    out, err, end = _read_all([reading for reading, _ in streams], time.monotonic() + timeout_s)
    pid, *status = end.decode().split()
    if not status:
        os.kill(int(pid), signal.SIGKILL)
        raise subprocess.TimeoutExpired([*words], timeout_s, out, err)
    return subprocess.CompletedProcess([*words], int(status[0]), out.decode(), err.decode())


def _read_all(descriptors: list[int], deadline: float) -> list[bytes]:
    """Return what comes from each, until all have ended or the deadline has passed."""
    parts = dict.fromkeys(descriptors, b"")
    with selectors.DefaultSelector() as selector:
        for descriptor in descriptors:
            selector.register(descriptor, selectors.EVENT_READ)
        while selector.get_map() and (left_s := deadline - time.monotonic()) > 0:
            for key, _ in selector.select(left_s):
                if part := os.read(key.fd, 1 << 16):
                    parts[key.fd] += part
                else:
                    selector.unregister(key.fd)
    for descriptor in descriptors:
        os.close(descriptor)
    return list(parts.values())


@cache
def _server() -> socket.socket:
    """Start the process that forks; it ends with this one."""
    here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    subprocess.Popen(
        [sys.executable, __file__, str(there.fileno())], pass_fds=[there.fileno()], stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL, env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, start_new_session=True,
    )  # fmt: skip
    there.close()
    return here


def _next_request(control: socket.socket) -> dict[str, Any]:
    """Fork for every request; return it in the new process, whose output is connected."""
    while True:
        content, descriptors, *_ = socket.recv_fds(control, _MOST_BYTES, 3)
        if not content:
            os._exit(0)
        if not os.fork():  # it waits for the command, and says how it ended
            control.close()
            if not (pid := os.fork()):
                for target, descriptor in enumerate(descriptors[:2], 1):
                    os.dup2(descriptor, target)
                for descriptor in descriptors:
                    os.close(descriptor)
                request: dict[str, Any] = json.loads(content)
                return request
            os.write(descriptors[2], b"%d " % pid)
            for descriptor in descriptors[:2]:
                os.close(descriptor)
            os.write(descriptors[2], b"%d" % os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]))
            os._exit(0)
        for descriptor in descriptors:
            os.close(descriptor)
        with suppress(ChildProcessError):
            while os.waitpid(-1, os.WNOHANG)[0]:
                continue


def _serve(control: socket.socket) -> None:
    """Import what commands need, and be a command in every process that is forked from this one."""
    folder = sys.path.pop(0)
    assert Path(folder) == Path(__file__).parent
    from codecbench.__main__ import main  # here, because tests import this module, too
    from codecbench.cli import COMMANDS, late

    modules = [target.partition(":")[0] for target, _ in COMMANDS.values()]
    for name in [*_LIBRARIES, *modules, *late.LATE]:
        with suppress(ImportError):  # an extra that is not installed
            vars(importlib.import_module(name))  # what loads late loads now
    gc.collect()
    gc.freeze()
    request = _next_request(control)
    environment = request["environment"]
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(request["cwd"])
    paths = list(filter(None, environment.get("PYTHONPATH", "").split(os.pathsep)))
    sys.path[:0] = paths
    sys.argv = [str(COMMAND), *request["words"]]
    if (most_bytes := request["most_bytes"]) is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (most_bytes, most_bytes))
    for path in paths:
        if (custom := Path(path, "sitecustomize.py")).exists():
            runpy.run_path(str(custom))
    sys.modules["__main__"].__file__ = str(COMMAND)  # for processes of multiprocessing
    main()


if __name__ == "__main__":
    _serve(socket.socket(fileno=int(sys.argv[1])))
