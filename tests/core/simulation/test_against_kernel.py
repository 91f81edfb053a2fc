"""Datagrams and TCP through queues of a real kernel, between two network namespaces, beside the simulation."""

from __future__ import annotations

import json
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

import numpy as np
import pytest

from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.simulation.delivery import Delivery, deliver
from codecbench.core.simulation.settings import LinkSettings
from codecbench.plugins.links.constant import Constant

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.getuid() != 0 or not (shutil.which("ip") and shutil.which("tc")),
        reason="takes root, and iproute2's ip and tc",
    ),
]

RATE_KBPS = 4000
PAYLOAD_BYTES, PACKET_BYTES = 1000, 1042  # with the headers of UDP, IP and Ethernet
SEGMENT_BYTES, SEGMENT_HEADERS = 1448, 66  # of TCP with time stamps, IP and Ethernet
PICTURE_BYTES = 4 * SEGMENT_BYTES

UDP_RECEIVER = """
import json, socket, struct
receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
receiver.bind(("10.77.0.2", 5000))
receiver.setsockopt(socket.SOL_SOCKET, 35, 1)  # SO_TIMESTAMPNS: the kernel's stamp, whenever this process is awake
receiver.settimeout(1.5)
print("ready", flush=True)
came = {}
try:
    while True:
        data, ((_, _, stamp),), *_ = receiver.recvmsg(2000, 100)
        seconds, nanoseconds = struct.unpack("qq", stamp)
        came[int(data[:8])] = seconds + 1e-9 * nanoseconds
except TimeoutError:
    print(json.dumps(came))
"""
TCP_RECEIVER = """
import json, socket, time
receiver = socket.create_server(("10.77.0.2", 5000))
receiver.settimeout(10)
print("ready", flush=True)
connection, _ = receiver.accept()
came, total, size = {}, 0, PICTURE_BYTES
while data := connection.recv(size):
    now, before, total = time.time(), total, total + len(data)
    came |= {number: now for number in range(before // size, total // size)}
print(json.dumps(came))
"""
SENDER = """
import json, socket, sys, time
is_tcp, times = json.load(sys.stdin)
sender = socket.socket(socket.AF_INET, socket.SOCK_STREAM if is_tcp else socket.SOCK_DGRAM)
sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 22)
sender.connect(("10.77.0.2", 5000))
if is_tcp:
    sender.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
begin, sent = time.time(), []
for number, due in enumerate(times):
    if (wait := begin + due - time.time()) > 0:
        time.sleep(wait)
    sent.append(time.time())
    sender.sendall(b"%08d" % number + bytes((PICTURE_BYTES if is_tcp else PAYLOAD_BYTES) - 8))
print(json.dumps(sent))
"""


def filled(program: str) -> str:
    return program.replace("PICTURE_BYTES", str(PICTURE_BYTES)).replace("PAYLOAD_BYTES", str(PAYLOAD_BYTES))


Spaces = Callable[..., AbstractContextManager[tuple[str, str]]]


@pytest.fixture
def spaces() -> Spaces:
    """Two network namespaces, joined by a cable; what leaves the first goes through a token bucket."""

    @contextmanager
    def joined(waiting: int, inside: str = "") -> Iterator[tuple[str, str]]:
        """waiting: packets that the bucket has room for. inside: what queues them there, instead of the bucket."""
        near, far = (f"cb{os.getpid()}{side}" for side in "ab")
        queues = [f"root handle 1: tbf rate {RATE_KBPS}kbit burst 1600 limit {waiting * PACKET_BYTES}"]
        queues += [f"parent 1: {inside}"] * bool(inside)
        lines = [
            f"ip netns add {near}", f"ip netns add {far}",
            f"ip link add near0 netns {near} type veth peer name far0 netns {far}",
            f"ip -n {near} addr add 10.77.0.1/24 dev near0", f"ip -n {far} addr add 10.77.0.2/24 dev far0",
            f"ip -n {near} link set near0 up", f"ip -n {far} link set far0 up",
            *(f"tc -n {near} qdisc add dev near0 {queue}" for queue in queues),
        ]  # fmt: skip
        try:
            for line in lines:
                done = subprocess.run(line.split(), capture_output=True, text=True)
                if done.returncode:
                    pytest.skip(f"{line}: {done.stderr.strip()}")
            yield near, far
        finally:
            for space in (near, far):
                subprocess.run(["ip", "netns", "del", space], capture_output=True)

    return joined


def through_kernel(near: str, far: str, times_s: np.ndarray, is_tcp: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """When each was sent, and when it was there: in seconds since the first, infinite where it never was."""

    def inside(space: str, program: str) -> subprocess.Popen[str]:
        command = ["ip", "netns", "exec", space, sys.executable, "-c", filled(program)]
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    receiver = inside(far, TCP_RECEIVER if is_tcp else UDP_RECEIVER)
    try:
        assert receiver.stdout is not None
        receiver.stdout.readline()
        sent_s = json.loads(inside(near, SENDER).communicate(json.dumps([is_tcp, times_s.tolist()]), timeout=30)[0])
        came = json.loads(receiver.communicate(timeout=30)[0])
    finally:
        receiver.kill()
    arrived_s = [came.get(str(number), math.inf) for number in range(len(sent_s))]
    return np.array(sent_s) - sent_s[0], np.array(arrived_s) - sent_s[0]


def simulated(sent_s: np.ndarray, size_bytes: int, link: Constant, **params: Any) -> Delivery:
    units = [SentPacket(number, size_bytes, True, number + 1) for number in range(len(sent_s))]
    settings = LinkSettings(link="given", queue_policy="fifo", **params)
    return deliver(units, sent_s, link, settings, np.random.default_rng(0))


def rate(times_s: np.ndarray) -> float:
    """Of what comes, a second."""
    times_s = np.sort(times_s[np.isfinite(times_s)])
    return float((len(times_s) - 1) / (times_s[-1] - times_s[0]))


def test_a_burst_of_datagrams_through_a_token_bucket(spaces: Spaces) -> None:
    count, waiting = 400, 100
    with spaces(waiting) as (near, far):
        _, came_s = through_kernel(near, far, np.zeros(count))
    link = Constant.create(rate_kbps=RATE_KBPS, queue_packets=waiting)
    found_s = simulated(1e-6 * np.arange(count), PACKET_BYTES, link, header_bytes=0).handed_s
    real_s, found_s = (np.sort(times_s[np.isfinite(times_s)]) for times_s in (came_s, found_s))
    assert len(real_s) == pytest.approx(len(found_s), abs=0.01 * count)
    assert rate(real_s) == pytest.approx(rate(found_s), rel=0.03)
    both = min(len(real_s), len(found_s))
    assert real_s[:both] == pytest.approx(found_s[:both], abs=0.010)


def poisson_s(count: int, interval_s: float) -> np.ndarray:
    return np.cumsum(np.random.default_rng(2).exponential(interval_s, count))


@pytest.mark.parametrize("load", [0.8, 3.0])
def test_tcp_through_a_token_bucket(load: float, spaces: Spaces) -> None:
    """Pictures that come at random, slower and faster than the link takes them."""
    count, taken_s = 200, 8e-3 * 4 * (SEGMENT_BYTES + SEGMENT_HEADERS) / RATE_KBPS
    with spaces(1000) as (near, far):
        sent_s, came_s = through_kernel(near, far, poisson_s(count, taken_s / load), is_tcp=True)
    link = Constant.create(rate_kbps=RATE_KBPS)
    mtu = {"mtu": SEGMENT_BYTES + SEGMENT_HEADERS, "header_bytes": SEGMENT_HEADERS}
    found = simulated(sent_s, PICTURE_BYTES, link, transport="reliable", **mtu)
    assert set(found.outcomes) == {"on time"}
    assert np.isfinite(came_s).all()
    assert rate(came_s) == pytest.approx(rate(found.handed_s), rel=0.03)
    assert np.median(np.abs(came_s - found.handed_s)) < 0.010  # the receiving process is not awake at once each time


def test_datagrams_through_fq_codel(spaces: Spaces) -> None:
    """A little more than the link takes, so that CoDel soon finds its rate of dropping."""
    count, interval_s = 3000, 8e-3 * PACKET_BYTES / RATE_KBPS / 1.08
    with spaces(1000, "fq_codel limit 1000 target 5ms interval 100ms") as (near, far):
        sent_s, came_s = through_kernel(near, far, interval_s * np.arange(count))
    link = Constant.create(rate_kbps=RATE_KBPS, queue="codel", queue_packets=1000)
    found = simulated(sent_s, PACKET_BYTES, link, header_bytes=0)
    came = np.isfinite(came_s)
    delays_s = np.median((came_s - sent_s)[came]), np.median((found.handed_s - found.captured_s)[found.output_frames])
    assert came.mean() == pytest.approx(len(found.output_frames) / count, abs=0.03)
    assert rate(came_s) == pytest.approx(rate(found.handed_s), rel=0.03)
    assert delays_s[0] == pytest.approx(delays_s[1], abs=0.010)
