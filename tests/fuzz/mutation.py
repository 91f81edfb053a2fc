"""A mutation fuzzer that keeps inputs which make a decoder say something new.

It runs the compiled kernels, with bounds checks, and so takes the place of coverage where there is none to see.
"""

from __future__ import annotations

import math
import struct
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from decoder_targets import Target
from limits import Finding, Verdict, judge

from codecbench import BitstreamError, Codec

_MAX_BYTES = 6000
_EDGES = (0, 1, 2, 7, 8, 63, 64, 127, 128, 255, 256, 1023, 4095, 32767, 32768, 65535, 65536, (1 << 22) - 1, 1 << 22,
          (1 << 24) + 1, (1 << 26) - 1, 1 << 26, (1 << 31) - 1, 1 << 31, (1 << 32) - 1)  # fmt: skip
_FORMATS = ("<H", ">H", "<I", ">I")
_UNREPAIRED_ONE_IN = 8


@dataclass
class Campaign:
    """What a run of the fuzzer found; findings are inputs by the text of what they caused."""

    inputs: int = 0
    cpu_s: float = 0.0
    verdicts: Counter[str] = field(default_factory=Counter)
    findings: dict[str, bytes] = field(default_factory=dict)
    slowest_s: float = 0.0
    largest_bytes: int = 0
    pool: int = 0


def mutated(data: bytes, other: bytes, rng: np.random.Generator) -> bytes:
    """A few changes, often one: bits, bytes, numbers at an edge, parts taken out, repeated or exchanged."""
    copy = bytearray(data)
    for _ in range(int(rng.geometric(0.5))):
        if not copy:
            break
        place, kind = int(rng.integers(len(copy))), int(rng.integers(8))
        if kind == 0:
            copy[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            copy[place] = int(rng.integers(256))
        elif kind == 2:
            pattern = _FORMATS[int(rng.integers(len(_FORMATS)))]
            number = _EDGES[int(rng.integers(len(_EDGES)))] & ((1 << 8 * struct.calcsize(pattern)) - 1)
            copy[place : place + struct.calcsize(pattern)] = struct.pack(pattern, number)
        elif kind == 3:
            del copy[place : place + int(rng.integers(1, 40))]
        elif kind == 4:
            copy[place:place] = copy[int(rng.integers(len(copy))) :][: int(rng.integers(1, 60))]
        elif kind == 5:
            part = rng.bytes(int(rng.integers(1, 20)))
            copy[place : place + len(part)] = part
        elif kind == 6:
            start = int(rng.integers(len(other) or 1))
            part = other[start : start + int(rng.integers(1, 200))]
            copy[place : place + len(part)] = part
        else:
            copy[place] = (copy[place] + int(rng.integers(-4, 5))) % 256
    return bytes(copy[:_MAX_BYTES])


def _judged_twice(codec: Codec[Any], data: bytes) -> Verdict:
    """The verdict, or the second finding: at the first an input may have had a kernel compiled that no seed had."""
    with suppress(Finding):
        return judge(codec, data)
    return judge(codec, data)


def fuzz(
    target: Target,
    seeds: list[bytes],
    seed: int,
    last_input: Path,
    *,
    seconds: float = math.inf,
    inputs: float = math.inf,
) -> Campaign:
    """Mutate for so long or so many inputs.

    Each input is written to `last_input` before it is decoded, so that a crash leaves it behind.
    """
    codec, rng, campaign = target.codec(), np.random.default_rng(seed), Campaign()
    for data in seeds:
        with suppress(BitstreamError):
            codec.decode(data)  # compiles the kernels, whose time is no decoder's
    pool, heard = list(seeds), set()
    end, cpu_start_s = time.monotonic() + seconds, time.process_time()
    while time.monotonic() < end and campaign.inputs < inputs:
        chosen, other = (pool[int(rng.integers(len(pool)))] for _ in range(2))
        data = mutated(chosen, other, rng)
        if rng.integers(_UNREPAIRED_ONE_IN):
            data = target.repair(data)
        last_input.write_bytes(data)
        campaign.inputs += 1
        try:
            verdict = _judged_twice(codec, data)
        except Finding as finding:
            campaign.findings.setdefault(str(finding)[:100], data)
            continue
        campaign.verdicts[f"{verdict.kind}: {verdict.text}"[:90]] += 1
        campaign.slowest_s = max(campaign.slowest_s, verdict.time_s)
        campaign.largest_bytes = max(campaign.largest_bytes, verdict.memory_bytes)
        if verdict.text not in heard or (verdict.kind == "decoded" and not rng.integers(20)):
            heard.add(verdict.text)
            pool.append(data)
    campaign.pool, campaign.cpu_s = len(pool), time.process_time() - cpu_start_s
    last_input.unlink(missing_ok=True)
    return campaign
