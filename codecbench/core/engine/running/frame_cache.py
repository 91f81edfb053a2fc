"""Raw frames kept in a worker, so that consecutive settings of a sequence read each frame once."""

from __future__ import annotations

from dataclasses import replace

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import check_image
from codecbench.core.contracts.sequence import Frame, FrameSequence

MOST_BYTES = 128 << 20
"""Two workers, each with these, half as many of decoded frames, and its compiled kernels, stay below 1.5 GB."""


def cache_limit_bytes(memory_mb: int) -> int:
    """What frames may take of a worker's memory cap: a quarter, so that codecs and evaluators have the rest."""
    return min(MOST_BYTES, (memory_mb << 20) // 4)


def check_frame(frame: object, channels: int) -> Frame:
    """`frame` after checking that it is one, with an image of so many channels."""
    if not isinstance(frame, Frame):
        raise DatasetError(f"read returned {type(frame).__name__}; it returns a Frame")
    check_image(frame.image, (channels,))
    return frame


class FrameCache:
    """Frames of the sequence in hand, up to `limit_bytes`.

    A sequence is read front to back again and again. Dropping the oldest frame would then drop each frame
    just before it is wanted, so a frame that does not fit is not kept; frames of other sequences make room.
    """

    def __init__(self, limit_bytes: int = MOST_BYTES) -> None:
        self.limit_bytes = limit_bytes
        self.used_bytes = 0
        self._frames: dict[str, dict[int, Frame]] = {}

    def read(self, sequence: FrameSequence, index: int) -> Frame:
        """Frame `index` of `sequence`, from memory where it was kept; the caller owns the pixels."""
        frames = self._frames.setdefault(sequence.fingerprint, {})
        frame = frames.get(index)
        if frame is None:
            frame = check_frame(sequence.read(index), sequence.channels)
            if not self._make_room(frame.image.nbytes, sequence.fingerprint):
                return frame
            frames[index] = frame
            self.used_bytes += frame.image.nbytes
        # A copy, so that whoever writes into it harms nobody; it shares what is cached of the kept frame.
        return replace(frame, image=frame.image.copy())

    def _make_room(self, size_bytes: int, keep: str) -> bool:
        for other in [name for name in self._frames if name != keep]:
            if self.used_bytes + size_bytes <= self.limit_bytes:
                break
            self.used_bytes -= sum(frame.image.nbytes for frame in self._frames.pop(other).values())
        return self.used_bytes + size_bytes <= self.limit_bytes


class CachedSequence(FrameSequence):
    """A sequence whose frames come through a cache; everything else is as the sequence says."""

    def __init__(self, source: FrameSequence, name: str, cache: FrameCache) -> None:
        self.name = name
        self.timestamps_s = source.timestamps_s
        self.frame_rate_hz = source.frame_rate_hz
        self.channels = source.channels
        self.camera = source.camera
        self.ground_truth = source.ground_truth
        self.fingerprint = source.fingerprint
        self._source = source
        self._cache = cache

    def read(self, index: int) -> Frame:
        return self._cache.read(self._source, index)
