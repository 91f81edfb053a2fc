"""What each architecture hands to SLAM, and what it sends for that."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Frame


class Feed:
    """The frames of a coded sequence from `start_offset` on, as SLAM is to see them.

    Raises Unsupported where the sequence has no frame left.
    """

    def __init__(self, coded: CodedSequence, architecture: Literal["cta", "atc"], start_offset: int) -> None:
        if start_offset >= len(coded):
            raise Unsupported(f"start offset {start_offset} leaves no frame of {len(coded)}; give a smaller one")
        self._coded = coded
        self._architecture = architecture
        self._indices = range(start_offset, len(coded))
        self._keyframes: set[int] = set()

    def __len__(self) -> int:
        return len(self._indices)

    def frames(self) -> Iterator[Frame]:
        """Decoded frames under `cta`, raw ones under `atc`."""
        for index in self._indices:
            if self._architecture == "atc":
                yield self._coded.sequence.read(index)
            else:
                coded = self._coded.frame(index)
                yield Frame(index, coded.original.timestamp_s, coded.decoded)

    @property
    def keyframe_image(self) -> Callable[[int], Image] | None:
        """Under `atc`, what mapping sees of a frame when it becomes a keyframe; None under `cta`."""
        return self._decoded_keyframe if self._architecture == "atc" else None

    def sent_size_bytes(self) -> int:
        """Bytes that the device has sent: of all frames under `cta`, of the keyframes asked for under `atc`."""
        sent = self._keyframes if self._architecture == "atc" else self._indices
        return sum(self._coded.size_bytes(index) for index in sent)

    def _decoded_keyframe(self, index: int) -> Image:
        self._keyframes.add(index)
        return self._coded.frame(index).decoded
