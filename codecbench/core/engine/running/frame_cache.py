"""Cache raw frames in a worker, so that consecutive settings of a sequence read each frame once."""

from __future__ import annotations

from dataclasses import replace

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Layout, check_image
from codecbench.core.contracts.sequence import Frame, FrameSequence

MOST_BYTES = 128 << 20
"""Two workers, each with such a cache, half of that in decoded frames, and compiled kernels, stay below 1.5 GB."""


def cache_limit_bytes(memory_mb: int) -> int:
    """Return the cache's share of a worker's memory limit: a quarter; codecs and evaluators get the rest."""
    return min(MOST_BYTES, (memory_mb << 20) // 4)


def check_frame(frame: object, layout: Layout) -> Frame:
    """Return `frame` after checking that it is a Frame with an image of this layout."""
    if not isinstance(frame, Frame):
        raise DatasetError(f"read returned {type(frame).__name__}; it must return a Frame")
    check_image(frame.image, (layout.channels,), (layout.bits,))
    return frame


class FrameCache:
    """Cache of frames of the current sequence, up to `limit_bytes`.

    A sequence is read front to back repeatedly. Dropping the oldest frame would drop each frame just before it is
    needed, so a frame that does not fit is not cached; frames of other sequences are evicted instead.
    """

    def __init__(self, limit_bytes: int = MOST_BYTES) -> None:
        self.limit_bytes = limit_bytes
        self.used_bytes = 0
        self._frames: dict[str, dict[int, Frame]] = {}

    def read(self, sequence: FrameSequence, index: int) -> Frame:
        """Return frame `index` of `sequence`, from the cache if possible; the caller owns the pixels."""
        frames = self._frames.setdefault(sequence.fingerprint, {})
        frame = frames.get(index)
        if frame is None:
            frame = check_frame(sequence.read(index), Layout(sequence.channels, sequence.bits))
            if not self._make_room(frame.image.nbytes, sequence.fingerprint):
                return frame
            frames[index] = frame
            self.used_bytes += frame.image.nbytes
        # A copy, so that writing into it is harmless; it shares cached properties with the stored frame.
        return replace(frame, image=frame.image.copy())

    def _make_room(self, size_bytes: int, kept_fingerprint: str) -> bool:
        for other in [name for name in self._frames if name != kept_fingerprint]:
            if self.used_bytes + size_bytes <= self.limit_bytes:
                break
            self.used_bytes -= sum(frame.image.nbytes for frame in self._frames.pop(other).values())
        return self.used_bytes + size_bytes <= self.limit_bytes


class CachedSequence(FrameSequence):
    """A sequence whose frames are read through a cache."""

    def __init__(self, source: FrameSequence, name: str, cache: FrameCache) -> None:
        self.name = name
        self.timestamps_s = source.timestamps_s
        self.frame_rate_hz = source.frame_rate_hz
        self.channels = source.channels
        self.bits = source.bits
        self.depth = source.depth
        self.camera = source.camera
        self.ground_truth = source.ground_truth
        self.fingerprint = source.fingerprint
        self._source = source
        self._cache = cache

    def read(self, index: int) -> Frame:
        return self._cache.read(self._source, index)
