"""Decode features: each packet gives the feature set of its frame, and sets are accessed by frame."""

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
    """The feature sets of a stream by frame, in any order; in-order access decodes each packet once.

    packets: of frames 0 to N - 1, in that order, as encoders of features return them. read: returns the bytes of a
    frame's packet.
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
        """Return the features of a frame. Raises CodingError if the decoder returns anything else."""
        start = self._starts[bisect_right(self._starts, frame) - 1]
        decoder, self._decoder = self._decoder, None  # not reused if it raises
        if decoder is None or not start <= self._next <= frame:
            decoder, self._next = self._codec.open_decoder(), start
        while True:
            sent = self._packets[self._next]
            self._position.at("decode", sent.frame)
            (feature_set,) = decoder.push(Packet(self._read(sent.frame), sent.frame, sent.starts))
            features = _check_features(feature_set, sent.frame)
            self._next += 1
            if sent.frame == frame:
                self._decoder = decoder
                return features


def _check_features(feature_set: object, frame: int) -> Features:
    if not isinstance(feature_set, FeatureSet):
        raise CodingError(f"the decoder returned {type(feature_set).__name__}; it must return a FeatureSet")
    if feature_set.frame != frame:
        raise CodingError(f"the decoder returned frame {feature_set.frame} for the packet of frame {frame}")
    if feature_set.features is None:
        raise CodingError(f"the decoder returned frame {frame} as missing, but nothing was lost")
    if not isinstance(feature_set.features, Features):
        raise CodingError(f"the decoder returned {type(feature_set.features).__name__}; a set must have Features")
    return feature_set.features
