"""Workers on other hosts: network namespaces that share no folder, SSH, and job scripts for Slurm and PBS."""

from __future__ import annotations

import getpass
import importlib.util
import logging
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
from dask_cluster import Cluster, Host, cluster_elsewhere
from engine_bench import OURS, Bench, bench_in, contents, matrix
from project import SUPPORT

pytestmark = pytest.mark.thorough

pytest.importorskip("distributed", reason="the extra codecbench[dask] is not installed")

log = logging.getLogger("hosts")
CODECS = "{use: faulty, params: {step: {grid: [0, 1, 2, 3]}}}"
HIDE = 'mount -t tmpfs none "$0" && exec "$@"'


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path) as made:
        yield made


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, text=True)


@dataclass(frozen=True)
class Network:
    """Three hosts: that of coordinator and scheduler, and two for workers, which do not see the folder `hidden`."""

    head: Host
    others: tuple[Host, ...]
    links: tuple[str, ...]
    name: str

    def moved_bytes(self) -> int:
        """What has gone over the links so far, in both directions."""
        total = 0
        for link in self.links:
            for way in ("rx_bytes", "tx_bytes"):
                path = f"/sys/class/net/{link}/statistics/{way}"
                words = [*self.head.enter, "cat", path]
                total += int(subprocess.run(words, check=True, capture_output=True, text=True).stdout)
        return total


@contextmanager
def network(hidden: Path) -> Iterator[Network]:
    """Hosts made of network namespaces, the first of which passes on what the others send to each other."""
    stem = f"cb{os.getpid() % 100000}"
    head, names = f"{stem}h", [f"{stem}w0", f"{stem}w1"]
    with ExitStack() as stack:
        for name in (head, *names):
            ip("netns", "add", name)
            stack.callback(subprocess.run, ["ip", "netns", "del", name], check=False, capture_output=True)
            ip("-n", name, "link", "set", "lo", "up")
        ip("-n", head, "address", "add", "10.213.0.1/32", "dev", "lo")
        ip("netns", "exec", head, "sh", "-c", "echo 1 > /proc/sys/net/ipv4/ip_forward")
        others = []
        for number, name in enumerate(names):
            here, there = f"{head}{number}", f"{name}n"
            ip("-n", head, "link", "add", here, "type", "veth", "peer", "name", there, "netns", name)
            ip("-n", head, "address", "add", f"10.213.{number + 1}.1/30", "dev", here)
            ip("-n", head, "link", "set", here, "up")
            ip("-n", name, "address", "add", f"10.213.{number + 1}.2/30", "dev", there)
            ip("-n", name, "link", "set", there, "up")
            ip("-n", name, "route", "add", "default", "via", f"10.213.{number + 1}.1")
            enter = ("ip", "netns", "exec", name, "sh", "-c", HIDE, str(hidden))
            others.append(Host(f"10.213.{number + 1}.2", enter))
        links = tuple(f"{head}{number}" for number in range(len(names)))
        yield Network(Host("10.213.0.1", ("ip", "netns", "exec", head)), tuple(others), links, stem)


def needs_namespaces() -> None:
    """Skip where this machine does not let this user make network namespaces."""
    if shutil.which("ip") is None:
        pytest.skip("no `ip` (iproute2) to make network namespaces with")
    name = f"cbtry{os.getpid() % 100000}"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode:
        pytest.skip(f"network namespaces need root: {made.stderr.strip()}")
    ip("netns", "del", name)


def drive(bench: Bench, host: Host, out: Path) -> subprocess.Popen[bytes]:
    """The coordinator, on a host of its own."""
    words = [SUPPORT / "run_driver.py", bench.folder / "matrix.yaml", out, bench.site]
    return subprocess.Popen([*host.enter, sys.executable, *map(str, words)])


@dataclass(frozen=True)
class Setup:
    """A cluster over the network's hosts, and a matrix in place; all that is the coordinator's is in `own`."""

    net: Network
    cluster: Cluster
    own: Path


@contextmanager
def hosts(bench: Bench, codecs: str, evaluators: str, more: str = "") -> Iterator[Setup]:
    own, theirs = bench.folder / "own", bench.folder / "theirs"
    own.mkdir()
    theirs.mkdir()
    shutil.copy(bench.folder / "stack.npy", theirs)
    shutil.move(bench.folder / "stack.npy", own)
    with (
        network(own) as net,
        cluster_elsewhere(bench.folder / "cluster", bench.site, 2, net.head, net.others) as cluster,
    ):
        params = f'address: "{cluster.address}", paths: {{{own}: {theirs}}}'
        run = f"workers: 2, executor: {{use: dask, params: {{{params}}}}}{more}"
        bench.plan(matrix(codecs, evaluators, run).replace("stack.npy", "own/stack.npy"))
        yield Setup(net, cluster, own)


@pytest.mark.slow
def test_hosts_that_share_only_a_network_find_the_same(bench: Bench) -> None:
    needs_namespaces()
    local = bench.plan(matrix(CODECS, "wandering, whole, alone"))
    bench.run(local, "local")
    with hosts(bench, CODECS, "wandering, whole, alone") as there:
        before = there.net.moved_bytes()
        assert drive(bench, there.net.head, there.own / "run").wait(120) == 0
        moved = there.net.moved_bytes() - before
        scratch = [path for path in (bench.folder / "cluster").rglob("*") if path.suffix in (".bits", ".parquet")]
        assert not scratch
        for worker in there.cluster.workers:
            seen = Path(f"/proc/{worker}/root{there.own}")
            assert not list(seen.iterdir()), "a worker does not see the coordinator's folder"
    store = bench.store("own/run")
    plan = store.read_plan()
    assert [cell.id for cell in plan.cells] == [cell.id for cell in local.cells]
    assert contents(store, plan) == contents(bench.store("local"), local)
    records = [store.read_record(cell.id) for cell in plan.cells]
    assert {record.status for record in records} == {"ok"}
    log.info("%d cells and 4 coding jobs: %d bytes over the network", len(records), moved)


@pytest.mark.slow
def test_a_host_whose_cable_is_pulled_loses_nothing(bench: Bench) -> None:
    needs_namespaces()
    evaluators = ", ".join(f"{{use: slow, params: {{step: {n}}}}}" for n in range(8))
    local = bench.plan(matrix(CODECS, evaluators))
    bench.run(local, "local")
    with hosts(bench, CODECS, evaluators) as there:
        coordinator = drive(bench, there.net.head, there.own / "run")
        store = bench.store("own/run")
        deadline = time.monotonic() + 60
        while len(store.entries()) < 4 and coordinator.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        ip("-n", there.net.head.enter[3], "link", "set", there.net.links[0], "down")
        assert coordinator.wait(300) == 0
    plan = store.read_plan()
    assert {store.read_record(cell.id).status for cell in plan.cells} == {"ok"}
    assert contents(store, plan) == contents(bench.store("local"), local)


@contextmanager
def ssh_server(folder: Path) -> Iterator[tuple[int, Path]]:
    """An SSH server of our own on this machine: its port, and the key that it lets in."""
    server = shutil.which("sshd", path=f"{os.environ['PATH']}:/usr/sbin:/sbin")
    if server is None or importlib.util.find_spec("asyncssh") is None:
        pytest.skip("needs sshd (openssh-server) and the package asyncssh")
    for name in ("host", "user"):
        subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", folder / name], check=True)
    port = 20000 + os.getpid() % 20000
    settings = {
        "Port": port, "ListenAddress": "127.0.0.1", "HostKey": folder / "host", "StrictModes": "no",
        "AuthorizedKeysFile": folder / "user.pub", "UsePAM": "no", "PidFile": "none", "PermitRootLogin": "yes",
    }  # fmt: skip
    (folder / "sshd_config").write_text("".join(f"{name} {value}\n" for name, value in settings.items()))
    if os.geteuid() == 0:
        Path("/run/sshd").mkdir(exist_ok=True)
    with open(folder / "sshd.log", "wb") as output:
        process = subprocess.Popen([server, "-D", "-e", "-f", folder / "sshd_config"], stdout=output, stderr=output)
    try:
        time.sleep(0.5)
        assert process.poll() is None, (folder / "sshd.log").read_text()
        yield port, folder / "user"
    finally:
        process.kill()
        process.wait()


def test_an_ssh_cluster_finds_the_same(bench: Bench) -> None:
    local = bench.plan(matrix(CODECS, "wandering, whole"))
    bench.run(local, "local")
    keys = bench.folder / "keys"
    keys.mkdir()
    known = set(psutil.pids())
    with ssh_server(keys) as (port, key):
        path = os.pathsep.join([str(bench.site), str(SUPPORT)])
        options = (
            "hosts: [127.0.0.1, 127.0.0.1, 127.0.0.1], "
            f"connect_options: {{port: {port}, username: {getpass.getuser()}, "
            f"client_keys: [{key}], known_hosts: null}}, "
            f"remote_python: 'env PYTHONPATH={path} {sys.executable}', "
            "worker_options: {nthreads: 1}, scheduler_options: {port: 0, dashboard_address: ':0'}"
        )
        executor = f"{{use: dask, params: {{cluster: ssh, options: {{{options}}}, shared_files: true}}}}"
        plan = bench.plan(matrix(CODECS, "wandering, whole", f"workers: 2, executor: {executor}"))
        assert bench.run(plan, "ssh").statuses == {"ok": 8}
        assert contents(bench.store("ssh"), plan) == contents(bench.store("local"), local)
        left = [one for one in psutil.process_iter(["cmdline"]) if one.pid not in known]
        left = [one for one in left if "distributed.cli.dask_spec" in (one.info["cmdline"] or [])]
        assert not psutil.wait_procs(left, timeout=20)[1]


QUEUES = {
    "slurm": ("sbatch", "scancel", 'echo "Submitted batch job $!"', "job_mem: 1GB"),
    "pbs": ("qsub", "qdel", 'echo "$!.here"', "resource_spec: 'select=1:ncpus=1:mem=1GB'"),
}


@pytest.mark.parametrize("queue", QUEUES)
def test_job_scripts_of_a_queue_bring_up_workers(bench: Bench, queue: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The commands of the queue are stand-ins that run the job script at once, here; the scripts are the real ones."""
    pytest.importorskip("dask_jobqueue", reason="needs the package dask-jobqueue")
    submit, cancel, answer, resources = QUEUES[queue]
    tools = bench.folder / "tools"
    tools.mkdir()
    kept = bench.folder / "jobs"
    kept.mkdir()
    run_it = f'job={kept}/$$.sh; cat "$1" > "$job"; setsid sh "$job" > "$job.log" 2>&1 & {answer}\n'
    (tools / submit).write_text(f"#!/bin/sh\n{run_it}")
    (tools / cancel).write_text('#!/bin/sh\nkill -TERM -- "-${1%%.*}"\n')
    for tool in tools.iterdir():
        tool.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tools}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(bench.site), str(SUPPORT), os.environ.get("PYTHONPATH", "")]))
    options = f"cores: 1, processes: 1, memory: 1GB, interface: lo, walltime: '00:10:00', {resources}"
    executor = f"{{use: dask, params: {{cluster: {queue}, options: {{{options}}}, shared_files: true}}}}"
    plan = bench.plan(matrix(OURS, "quality", f"workers: 2, executor: {executor}"))
    assert bench.run(plan, "queued").statuses == {"ok": 2}
    scripts = [path.read_text() for path in kept.glob("*.sh")]
    assert len(scripts) == 2
    marker = {"slurm": "#SBATCH", "pbs": "#PBS"}[queue]
    assert all(marker in script and "cli.dask_worker" in script for script in scripts)
    local = bench.plan(matrix(OURS, "quality"))
    bench.run(local, "local")
    assert contents(bench.store("queued"), plan) == contents(bench.store("local"), local)
