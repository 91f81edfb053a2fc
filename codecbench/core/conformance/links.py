"""Checks of the link contract."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from codecbench.core.conformance.harness import ConformanceFailure
from codecbench.core.contracts.link import Link, Passage

_PACKETS: Final = 2000
_SEEDS: Final = (0, 1)
_ROUNDING_S: Final = 1e-9

Sent = tuple[int, float]
"""Size of a packet in bytes, and the time in seconds at which it starts."""


def check_link(link: Link[Any]) -> None:
    """Run every check on a link. Raises ConformanceFailure for the first that it fails."""
    for seed in _SEEDS:
        transmissions = [send_packets(link, seed, pattern) for pattern in (_steady, _bursts)]
        for sent, passages in transmissions:
            for check in CHECKS:
                check(link, sent, passages)
        again = send_packets(link, seed, _steady)
        if again != transmissions[0]:
            raise ConformanceFailure(
                f"{link.name}: the same packets twice from seed {seed}", "other passages", "the same"
            )


def send_packets(
    link: Link[Any], seed: int, gap_s: Callable[[np.random.Generator], float]
) -> tuple[list[Sent], list[Passage]]:
    """Send packets of all sizes over a newly opened link, each due `gap_s` after the one before."""
    channel, rng = link.open(np.random.default_rng(seed)), np.random.default_rng(1000 + seed)
    sent: list[Sent] = []
    passages: list[Passage] = []
    free_s = due_s = 0.0
    for _ in range(_PACKETS):
        due_s += gap_s(rng)
        size_bytes, start_s = int(rng.integers(1, 1501)), max(free_s, due_s)
        passage = channel.carry(size_bytes, start_s)
        sent.append((size_bytes, start_s))
        passages.append(passage)
        free_s = max(start_s, passage.sent_s)
    return sent, passages


def one_outcome(link: Link[Any], sent: list[Sent], passages: list[Passage]) -> None:
    """Check that every packet leaves at a finite time, and arrives at one or is lost."""
    for (size_bytes, start_s), passage in zip(sent, passages, strict=True):
        times = [passage.sent_s] if passage.arrives_s is None else [passage.sent_s, passage.arrives_s]
        if not all(isinstance(time_s, float | int) and math.isfinite(time_s) for time_s in times):
            raise ConformanceFailure(f"{link.name}: {size_bytes} bytes at {start_s:g} s", passage, "finite times")


def causal(link: Link[Any], sent: list[Sent], passages: list[Passage]) -> None:
    """Check that no packet leaves before it starts, or arrives before it has left and the delay has passed."""
    for (size_bytes, start_s), passage in zip(sent, passages, strict=True):
        where = f"{link.name}: {size_bytes} bytes at {start_s:g} s"
        if passage.sent_s < start_s:
            raise ConformanceFailure(where, f"sent at {passage.sent_s:g} s", "at its start or later")
        earliest_s = passage.sent_s + link.delay_s - _ROUNDING_S
        if passage.arrives_s is not None and passage.arrives_s < earliest_s:
            raise ConformanceFailure(
                where, f"arrival at {passage.arrives_s:g} s", f"{earliest_s:g} s or later: when sent, plus the delay"
            )


def in_order(link: Link[Any], sent: list[Sent], passages: list[Passage]) -> None:
    """Check that packets arrive in order, if the link declares that it keeps it."""
    if not link.keeps_order:
        return
    latest_s = -math.inf
    for (_, start_s), passage in zip(sent, passages, strict=True):
        if passage.arrives_s is None:
            continue
        if passage.arrives_s < latest_s:
            raise ConformanceFailure(
                f"{link.name}: the packet of {start_s:g} s",
                f"arrival at {passage.arrives_s:g} s",
                f"{latest_s:g} s or later",
            )
        latest_s = passage.arrives_s


CHECKS: Final = (one_outcome, causal, in_order)


def _steady(rng: np.random.Generator) -> float:
    return float(rng.exponential(0.01))


def _bursts(rng: np.random.Generator) -> float:
    return float(rng.exponential(0.5)) if rng.random() < 0.05 else 0.0
