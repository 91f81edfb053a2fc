"""The link `trace`: a Mahimahi trace lists the times at which 1,500 bytes can be sent.

Source: Netravali et al., "Mahimahi: Accurate Record-and-Replay for HTTP", USENIX ATC 2015, section 3: each line is a
millisecond since the start at which a packet of 1,500 bytes can be delivered. Smaller packets share such an
opportunity, larger ones take several; unused ones are lost. After the time in its last line, the trace starts again.
"""

from __future__ import annotations

import gzip
import hashlib
from bisect import bisect_left
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.link import Channel, Passage
from codecbench.core.contracts.params import PathParam
from codecbench.plugins.links.queued import QueuedLink, QueuedParams, Share, random_numbers

OPPORTUNITY_BYTES: Final = 1500

Embedded = Literal["lte_still", "lte_moving", "wifi_walking"]


class TraceParams(QueuedParams):
    """Set the trace and further losses; see also QueuedParams.

    trace: an included trace, made by `codecbench.plugins.links.generator`. file: your own trace, used instead.
    offset_ms: time in the trace at which the sequence starts; default: random. loss: probability that a packet is lost,
    independent of the others.
    """

    trace: Embedded = "lte_still"
    file: PathParam | None = None
    offset_ms: Annotated[int, Field(ge=0)] | None = None
    loss: Share = 0.0

    def identity(self) -> dict[str, Any]:
        """A file counts by its content, wherever it is."""
        identity = self.model_dump(mode="json")
        if self.file is not None:
            content = self.file.read_bytes() if self.file.is_file() else b""
            identity |= {"file": "", "content": hashlib.sha256(content).hexdigest()}
        return identity


class Trace(QueuedLink[TraceParams]):
    """Sends packets in order, at the opportunities of the trace. Raises Unsupported if there is no trace."""

    name = "trace"
    version = "1"
    params_type = TraceParams

    def __init__(self, params: TraceParams) -> None:
        super().__init__(params)
        self._opportunities_ms = embedded_trace(params.trace) if params.file is None else _read_trace(params.file)

    def open(self, rng: np.random.Generator) -> Channel:
        offset_rng, loss_rng = rng.spawn(2)
        period_ms = self._opportunities_ms[-1]
        offset_ms = self.params.offset_ms
        offset_ms = int(offset_rng.integers(period_ms)) if offset_ms is None else offset_ms % period_ms
        return _TraceChannel(self._opportunities_ms, offset_ms, self.delay_s, self.params.loss, loss_rng)


class _TraceChannel(Channel):
    """Uses opportunity number `_place`, of which `_left_bytes` are left."""

    def __init__(
        self, opportunities_ms: list[int], offset_ms: int, delay_s: float, loss: float, rng: np.random.Generator
    ) -> None:
        self._opportunities_ms, self._offset_ms, self._delay_s = opportunities_ms, offset_ms, delay_s
        self._loss, self._draws = loss, random_numbers(rng.random)
        self._place, self._left_bytes = -1, 0

    def carry(self, size_bytes: int, start_s: float) -> Passage:
        if self._place < 0 or self._time_s(self._place) < start_s:
            self._place, self._left_bytes = self._first_place(start_s), OPPORTUNITY_BYTES
        beyond = max(0, size_bytes - self._left_bytes)
        more = -(-beyond // OPPORTUNITY_BYTES)
        self._place += more
        self._left_bytes += more * OPPORTUNITY_BYTES - size_bytes
        sent_s = self._time_s(self._place)
        if self._loss and next(self._draws) < self._loss:
            return Passage(sent_s, None)
        return Passage(sent_s, sent_s + self._delay_s)

    def _time_s(self, place: int) -> float:
        loops, within = divmod(place, len(self._opportunities_ms))
        period_ms = self._opportunities_ms[-1]
        return 1e-3 * (loops * period_ms + self._opportunities_ms[within] - self._offset_ms)

    def _first_place(self, start_s: float) -> int:
        """The number of the first opportunity at `start_s` or later."""
        period_ms = self._opportunities_ms[-1]
        loops, within_ms = divmod(1e3 * start_s + self._offset_ms, period_ms)
        place = int(loops) * len(self._opportunities_ms) + bisect_left(self._opportunities_ms, within_ms - 1e-6)
        while self._time_s(place) < start_s:
            place += 1
        return place


@lru_cache
def embedded_trace(name: Embedded) -> list[int]:
    """The opportunities of an embedded trace, in milliseconds."""
    content = (files("codecbench.plugins.links") / "traces" / f"{name}.gz").read_bytes()
    return opportunities_ms(gzip.decompress(content).decode(), name)


def opportunities_ms(text: str, source: str) -> list[int]:
    """The lines of a trace. Raises Unsupported, naming `source` and the line, if one is not valid."""
    times_ms: list[int] = []
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip().isdecimal():
            raise Unsupported(f"{source}:{number}: got {line[:40]!r}; expected a whole number of milliseconds")
        times_ms.append(int(line))
        if len(times_ms) > 1 and times_ms[-1] < times_ms[-2]:
            raise Unsupported(f"{source}:{number}: {times_ms[-1]} comes after {times_ms[-2]}; times must not decrease")
    if not times_ms or not times_ms[-1]:
        raise Unsupported(f"{source}: got no time above 0; a trace needs one")
    return times_ms


def _read_trace(path: Path) -> list[int]:
    try:
        return opportunities_ms(path.read_text(encoding="ascii", errors="replace"), str(path))
    except OSError as error:
        raise Unsupported(
            f"the trace {path} cannot be read: {error.strerror}; give the path of a Mahimahi file"
        ) from error
