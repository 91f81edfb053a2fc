"""Packets through links of ns-3, another simulator, beside ours. It is a program of its own, which this one starts."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.simulation.delivery import deliver
from codecbench.core.simulation.settings import LinkSettings
from codecbench.plugins.links.constant import Constant
from codecbench.plugins.links.gilbert_elliott import GilbertElliott

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("ns") is None, reason="takes ns-3 (pip install ns3), which CONTRIBUTING.md explains"),
]

PPP_BYTES = 2
"""Headers of ns-3's point-to-point devices."""
PROGRAM = r"""
import json, sys
from ns import ns

ns.cppyy.cppdef('''
#include <cstring>
#include <map>
#include <vector>
using namespace ns3;
static std::map<uint64_t, double> arrivals;
static bool receive(Ptr<NetDevice>, Ptr<const Packet> packet, uint16_t, const Address&) {
  uint64_t number;
  packet->CopyData(reinterpret_cast<uint8_t*>(&number), sizeof number);
  arrivals[number] = Simulator::Now().GetSeconds();
  return true;
}
static void send(Ptr<NetDevice> device, uint64_t number, uint32_t size) {
  std::vector<uint8_t> bytes(size);
  std::memcpy(bytes.data(), &number, sizeof number);
  device->Send(Create<Packet>(bytes.data(), size), device->GetBroadcast(), 0x0800);
}
std::vector<double> through(double kbps, double delay_ms, int waiting, double burst_rate, int longest_burst,
                            const std::vector<double>& times, const std::vector<int>& sizes) {
  arrivals.clear();
  NodeContainer nodes;
  nodes.Create(2);
  PointToPointHelper link;
  link.SetDeviceAttribute("DataRate", DataRateValue(DataRate(uint64_t(1000 * kbps))));
  link.SetChannelAttribute("Delay", TimeValue(Seconds(1e-3 * delay_ms)));
  link.SetQueue("ns3::DropTailQueue", "MaxSize", QueueSizeValue(QueueSize(std::to_string(waiting) + "p")));
  NetDeviceContainer ends = link.Install(nodes);
  if (burst_rate > 0) {
    Ptr<UniformRandomVariable> length = CreateObject<UniformRandomVariable>();
    length->SetAttribute("Min", DoubleValue(1));
    length->SetAttribute("Max", DoubleValue(longest_burst));
    Ptr<BurstErrorModel> errors = CreateObject<BurstErrorModel>();
    errors->SetBurstRate(burst_rate);
    errors->SetRandomBurstSize(length);
    ends.Get(1)->SetAttribute("ReceiveErrorModel", PointerValue(errors));
  }
  ends.Get(1)->SetReceiveCallback(MakeCallback(&receive));
  for (size_t i = 0; i < times.size(); ++i)
    Simulator::Schedule(Seconds(times[i]), &send, ends.Get(0), uint64_t(i), uint32_t(sizes[i]));
  Simulator::Run();
  Simulator::Destroy();
  std::vector<double> found(times.size(), -1.0);
  for (auto& [number, time] : arrivals) found[number] = time;
  return found;
}
''')
print(json.dumps([list(ns.cppyy.gbl.through(*case)) for case in json.load(sys.stdin)]))
"""

COUNT, MANY = 20_000, 100_000
RATE_KBPS, DELAY_MS = 2000.0, 15.0
MEAN_BYTES = 800
RNG = np.random.default_rng(8)
SIZES = RNG.integers(2 * MEAN_BYTES - 1400, 1401, COUNT).tolist()


def poisson_s(load: float) -> list[float]:
    """When packets leave that keep the link busy for this share of the time, or come faster than it can send."""
    return np.cumsum(RNG.exponential(8e-3 * MEAN_BYTES / RATE_KBPS / load, COUNT)).tolist()  # type: ignore[no-any-return]


EVENLY_S = (1e-3 * np.arange(MANY)).tolist()
CASES: dict[str, tuple[Any, ...]] = {
    "rate and delay": (RATE_KBPS, DELAY_MS, 10_000, 0.0, 1, poisson_s(0.7), SIZES),
    "drop-tail": (RATE_KBPS, DELAY_MS, 20, 0.0, 1, poisson_s(1.3), SIZES),
    # Nine packets at most, five on average, are lost together; then one passes, and each of the next may be the first.
    "bursts": (10_000.0, DELAY_MS, 100, 1 / 45, 9, EVENLY_S, [100] * MANY),
}
LINKS = {
    "rate and delay": Constant.create(rate_kbps=RATE_KBPS, delay_ms=DELAY_MS, queue_packets=10_000),
    "drop-tail": Constant.create(rate_kbps=RATE_KBPS, delay_ms=DELAY_MS, queue_packets=20),
    "bursts": GilbertElliott.create(rate_kbps=10_000, delay_ms=DELAY_MS, good_ms=45, bad_ms=5, bad_loss=1.0),
}


@pytest.fixture(scope="module")
def theirs() -> dict[str, np.ndarray]:
    """By case, how long each packet took, in seconds; infinite for those that never came."""
    program = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(program, input=json.dumps(list(CASES.values())), capture_output=True, text=True, timeout=300)
    if done.returncode:
        pytest.skip(f"ns-3 does not run here: {done.stderr[-300:]}")
    found = json.loads(done.stdout.splitlines()[-1])
    return {
        name: np.where(np.array(times_s) < 0.0, math.inf, np.array(times_s) - case[5])
        for (name, case), times_s in zip(CASES.items(), found, strict=True)
    }


def ours(name: str) -> np.ndarray:
    times_s, sizes = np.array(CASES[name][5]), CASES[name][6]
    units = [SentPacket(number, size + PPP_BYTES, True, number + 1) for number, size in enumerate(sizes)]
    settings = LinkSettings(link="given", queue_policy="fifo", header_bytes=0)
    found = deliver(units, times_s, LINKS[name], settings, np.random.default_rng(0))
    return found.handed_s - found.captured_s


@pytest.mark.parametrize("name", CASES)
def test_as_many_packets_come_and_take_as_long(name: str, theirs: dict[str, np.ndarray]) -> None:
    both = theirs[name], ours(name)
    shares = [float(np.isfinite(taken_s).mean()) for taken_s in both]
    medians_s = [float(np.median(taken_s[np.isfinite(taken_s)])) for taken_s in both]
    assert (shares[0] < 0.95) == (name != "rate and delay")
    assert shares[1] == pytest.approx(shares[0], abs=0.01)
    assert medians_s[1] == pytest.approx(medians_s[0], abs=0.002)


@pytest.mark.parametrize("name", ["rate and delay", "drop-tail"])
def test_without_chance_each_packet_takes_as_long(name: str, theirs: dict[str, np.ndarray]) -> None:
    there, here = theirs[name], ours(name)
    came = np.isfinite(there) & np.isfinite(here)
    assert (np.isfinite(there) == np.isfinite(here)).mean() > 0.999
    assert there[came] == pytest.approx(here[came], abs=0.002)
