"""A dask cluster in processes of its own, also on hosts of their own: network namespaces of this machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).parent


@dataclass(frozen=True)
class Host:
    """Where a process runs. enter: words before its command. address: of its network interface."""

    address: str = "127.0.0.1"
    enter: tuple[str, ...] = ()


@dataclass(frozen=True)
class Cluster:
    """A running cluster: where its scheduler listens, and the process ids of scheduler and workers."""

    address: str
    scheduler: int
    workers: list[int] = field(default_factory=list)


@contextmanager
def cluster_elsewhere(
    folder: Path,
    site: Path,
    workers: int = 2,
    scheduler_host: Host = Host(),
    hosts: Sequence[Host] = (Host(),),
    protocol: str = "tcp",
) -> Iterator[Cluster]:
    """A scheduler and single-threaded workers, each with a scratch folder of its own; workers take turns on hosts."""
    folder.mkdir()
    with ExitStack() as stack:

        def start(host: Host, name: str, *command: str) -> int:
            scratch = folder / name
            scratch.mkdir()
            places = {"PYTHONPATH": os.pathsep.join([str(site), str(HERE)]), "TMPDIR": str(scratch)}
            log = stack.enter_context(open(folder / f"{name}.log", "wb"))
            words = [*host.enter, sys.executable, "-m", *command]
            process = subprocess.Popen(words, cwd=scratch, env={**os.environ, **places}, stdout=log, stderr=log)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process.pid

        where = folder / "scheduler.json"
        options = ["--host", scheduler_host.address, "--port", "0", "--no-dashboard", "--scheduler-file", str(where)]
        options += ["--protocol", protocol]
        scheduler = start(scheduler_host, "s", "distributed.cli.dask_scheduler", *options)
        deadline = time.monotonic() + 60
        while not where.exists():
            assert time.monotonic() < deadline, (folder / "s.log").read_text()
            time.sleep(0.1)
        address = json.loads(where.read_text())["address"]
        pids = []
        for number in range(workers):
            host = hosts[number % len(hosts)]
            listen = ["--host", host.address, "--name", f"w{number}"]
            limits = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--memory-limit", "0"]
            pids.append(start(host, f"w{number}", "distributed.cli.dask_worker", address, *listen, *limits))
        yield Cluster(address, scheduler, pids)
