"""A burst of datagrams through a real kernel's token bucket, between two network namespaces, beside the simulation."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator

import numpy as np
import pytest

from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.simulation.delivery import deliver
from codecbench.core.simulation.settings import LinkSettings
from codecbench.plugins.links.constant import Constant

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        os.getuid() != 0 or not (shutil.which("ip") and shutil.which("tc")),
        reason="takes root, and iproute2's ip and tc",
    ),
]

RATE_KBPS, WAITING, PACKETS = 4000, 100, 400
PAYLOAD_BYTES, PACKET_BYTES = 1000, 1042  # with the headers of UDP, IP and Ethernet

RECEIVER = """
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
SENDER = f"""
import json, socket, time
sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
sender.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 22)
sent = {{}}
for number in range({PACKETS}):
    sent[number] = time.time()
    sender.sendto(b"%08d" % number + bytes({PAYLOAD_BYTES} - 8), ("10.77.0.2", 5000))
print(json.dumps(sent))
"""


@pytest.fixture
def spaces() -> Iterator[tuple[str, str]]:
    """Two network namespaces, joined by a cable; what leaves the first goes through a token bucket."""
    near, far = (f"cb{os.getpid()}{side}" for side in "ab")
    lines = [
        f"ip netns add {near}", f"ip netns add {far}",
        f"ip link add near0 netns {near} type veth peer name far0 netns {far}",
        f"ip -n {near} addr add 10.77.0.1/24 dev near0", f"ip -n {far} addr add 10.77.0.2/24 dev far0",
        f"ip -n {near} link set near0 up", f"ip -n {far} link set far0 up",
        f"tc -n {near} qdisc add dev near0 root tbf rate {RATE_KBPS}kbit burst 1600 limit {WAITING * PACKET_BYTES}",
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


def through_kernel(near: str, far: str) -> np.ndarray:
    """(A,) when each packet that came through arrived, in seconds since the first was sent."""

    def inside(space: str, program: str) -> subprocess.Popen[str]:
        command = ["ip", "netns", "exec", space, sys.executable, "-c", program]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    receiver = inside(far, RECEIVER)
    assert receiver.stdout is not None
    receiver.stdout.readline()
    sent = json.loads(inside(near, SENDER).communicate(timeout=20)[0])
    came = json.loads(receiver.communicate(timeout=20)[0])
    return np.sort(list(came.values())) - sent["0"]


def simulated() -> np.ndarray:
    units = [SentPacket(frame, PACKET_BYTES, True, frame + 1) for frame in range(PACKETS)]
    link = Constant.create(rate_kbps=RATE_KBPS, queue_packets=WAITING)
    settings = LinkSettings(link="given", queue_policy="fifo", header_bytes=0)
    found = deliver(units, 1e-6 * np.arange(PACKETS), link, settings, np.random.default_rng(0))
    return found.handed_s[found.handed]


def test_a_burst_through_a_token_bucket_is_what_is_simulated(spaces: tuple[str, str]) -> None:
    real_s, simulated_s = through_kernel(*spaces), simulated()
    assert len(real_s) == pytest.approx(len(simulated_s), abs=0.01 * PACKETS)
    rates = [8e-3 * PACKET_BYTES * (len(times_s) - 1) / (times_s[-1] - times_s[0]) for times_s in (real_s, simulated_s)]
    assert rates[0] == pytest.approx(rates[1], rel=0.03)
    both = min(len(real_s), len(simulated_s))
    assert real_s[:both] == pytest.approx(simulated_s[:both], abs=0.010)
