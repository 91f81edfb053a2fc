"""One input to one decoder, held to what the contract allows: an image or BitstreamError, in time, in memory."""

from __future__ import annotations

import re
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

MAX_MEMORY_BYTES = 512 << 20
MAX_TIME_S = 10.0
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_RESET_PEAK = "5"
_PARTICULARS = re.compile(r"""b?'.*'|b".*"|\b[0-9a-f]{6,8}\b|-?\b\w*\d[\w.]*""")


class Finding(AssertionError):
    """A decoder did what the contract forbids."""


@dataclass(frozen=True)
class Verdict:
    """What a decoder made of an input: `refused` or `decoded`, a text without its particulars, and what it took."""

    kind: str
    text: str
    time_s: float
    memory_bytes: int


def judge(codec: Any, data: bytes) -> Verdict:
    """Decode `data`. Raises Finding where the result is neither an image nor BitstreamError, or costs too much."""
    from codecbench import BitstreamError
    from codecbench.core.contracts.image import MAX_PIXELS, check_image

    _CLEAR.write_text(_RESET_PEAK)
    before, start = _peak_bytes(), time.perf_counter()
    try:
        pixels = codec.decode(data)
        check_image(pixels, bits=(8, 16))
        kind, text = "decoded", f"{pixels.ndim} dimensions"
    except BitstreamError as error:
        kind, text = "refused", _PARTICULARS.sub("#", str(error))
    except Exception as error:
        raise Finding(f"{codec.name}: raised {type(error).__name__}: {error}") from error
    time_s, memory_bytes = time.perf_counter() - start, _peak_bytes() - before
    if kind == "decoded" and pixels.shape[0] * pixels.shape[1] > MAX_PIXELS:
        raise Finding(f"{codec.name}: an image of shape {pixels.shape}")
    if time_s > MAX_TIME_S:
        raise Finding(f"{codec.name}: {time_s:.1f} s for {len(data)} bytes; allowed: {MAX_TIME_S} s")
    if memory_bytes > MAX_MEMORY_BYTES:
        raise Finding(
            f"{codec.name}: {memory_bytes >> 20} MiB for {len(data)} bytes; allowed: {MAX_MEMORY_BYTES >> 20}"
        )
    return Verdict(kind, text, time_s, memory_bytes)


def _peak_bytes() -> int:
    """The largest resident size since the peak was last reset."""
    found = re.search(r"VmHWM:\s+(\d+) kB", _STATUS.read_text())
    assert found is not None
    return int(found[1]) << 10
