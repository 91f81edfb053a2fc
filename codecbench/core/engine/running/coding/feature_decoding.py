"""Decoding features: each packet gives the set of its frame, and sets are found again by frame."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Any

from codecbench.core.contracts.codec import AnyCodec, Decoder
from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.contracts.features import Features, FeatureSet
from codecbench.core.contracts.stream import Packet
from codecbench.core.engine.running.coding.position import CodingError, WorkPosition


class StreamFeatures:
    """The sets of a stream by frame, in any order; who asks in order has each packet decoded once.

    packets: of frames 0 to N - 1, in that order, as encoders of features give them. read: the bytes of a frame's.
    """

    def __init__(
        self,
        codec: AnyCodec[Any],
        packets: Sequence[SentPacket],
        read: Callable[[int], bytes],
        position: WorkPosition,
    ) -> None:
        self._codec, self._packets, self._read, self._position = codec, packets, read, position
        self._starts = [packet.frame for packet in packets if packet.starts]
        self._decoder: Decoder | None = None
        self._next = 0

    def features(self, frame: int) -> Features:
        """The features of a frame. Raises CodingError where the decoder gives anything else."""
        start = self._starts[bisect_right(self._starts, frame) - 1]
        decoder, self._decoder = self._decoder, None  # one that raises is not used again
        if decoder is None or not start <= self._next <= frame:
            decoder, self._next = self._codec.open_decoder(), start
        while True:
            sent = self._packets[self._next]
            self._position.at("decode", sent.frame)
            (found,) = decoder.push(Packet(self._read(sent.frame), sent.frame, sent.starts))
            features = _checked(found, sent.frame)
            self._next += 1
            if sent.frame == frame:
                self._decoder = decoder
                return features


def _checked(found: object, frame: int) -> Features:
    if not isinstance(found, FeatureSet):
        raise CodingError(f"the decoder returned {type(found).__name__}; it returns a FeatureSet")
    if found.frame != frame:
        raise CodingError(f"the decoder returned frame {found.frame} for the packet of frame {frame}")
    if found.features is None:
        raise CodingError(f"the decoder says that frame {frame} is missing, though nothing was lost")
    if not isinstance(found.features, Features):
        raise CodingError(f"the decoder returned {type(found.features).__name__}; a set has Features")
    return found.features
