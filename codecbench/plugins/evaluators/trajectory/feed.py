"""The frames or features that each architecture gives to SLAM, and the bytes that it sends for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.codec import AnyCodec, gets_features, sends_no_picture
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.contracts.features import FeatureFrame
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera, Frame
from codecbench.core.contracts.slam import SlamBackend, SlamRun
from codecbench.core.simulation.delivery import DeliveredFrames, Delivery

Architecture = Literal["cta", "atc", "features"]


def architecture_of(codec: AnyCodec[Any], requested: Architecture) -> Architecture:
    """The architecture for a codec: `features` for a feature codec, else the one requested for.

    Raises Unsupported for `features` with an image codec, and for `atc`, which sends images, with a feature codec.
    """
    if not gets_features(codec, requested):
        return requested
    if requested == "atc":
        raise sends_no_picture(codec)
    return "features"


class Feed:
    """The frames of a coded sequence from `start_offset` on, as SLAM sees them.

    Under `atc` only the chosen frames are sent; with an inter-frame codec, they alone make up the stream. Over a link
    SLAM sees the frames that are delivered and for which it has time; `read_at` is when it has finished each.
    stamps_s: of all frames from the offset on, seen or not. Raises Unsupported if the sequence has no frame left.
    """

    def __init__(
        self,
        coded: CodedSequence,
        architecture: Architecture,
        start_offset: int,
        delivery: Delivery | None = None,
        slam_s: float = 0.0,
    ) -> None:
        """slam_s: time that SLAM takes for a frame that comes over a link."""
        if start_offset >= len(coded):
            raise Unsupported(f"start offset {start_offset} leaves no frame of {len(coded)}; give a smaller one")
        self._coded = coded
        self._all = range(start_offset, len(coded))
        self._delivery = delivery
        self.read_at = {} if delivery is None else delivery.read_at(slam_s)
        self._indices = [index for index in self._all if delivery is None or index in self.read_at]
        self.stamps_s: NDArray[np.float64] = np.asarray(coded.sequence.timestamps_s[start_offset:], dtype=np.float64)
        self.seen = 0
        self._pictures = None if delivery is None else DeliveredFrames(coded, delivery)
        self._sender = coded.sender() if architecture == "atc" else None
        self._sends_features = architecture == "features"
        self._sizes_bytes: dict[int, int] = {}

    def __len__(self) -> int:
        return len(self._indices)

    def run(self, backend: SlamBackend[Any], camera: Camera, seed: int) -> SlamRun:
        """Run a backend on the frames, or under `features` on their features."""
        if self._sends_features:
            return backend.run_features(self.feature_frames(), camera, seed=seed)
        return backend.run(self.frames(), camera, seed=seed, keyframe_image=self.keyframe_image)

    def feature_frames(self) -> Iterator[FeatureFrame]:
        """The features of the frames; `seen` counts them."""
        for index in self._indices:
            self.seen += 1
            yield FeatureFrame(index, float(self._coded.sequence.timestamps_s[index]), self._coded.features(index))

    def frames(self) -> Iterator[Frame]:
        """Decoded frames under `cta`, raw ones under `atc`; `seen` counts them."""
        for index in self._indices:
            frame = self._frame(index)
            if frame is not None:
                self.seen += 1
                yield frame

    def _frame(self, index: int) -> Frame | None:
        if self._pictures is not None:
            picture = self._pictures.image(index)
            stamp_s = float(self._coded.sequence.timestamps_s[index])
            return None if picture is None else Frame(index, stamp_s, picture)
        if self._sender is not None:
            return self._coded.sequence.read(index)
        coded = self._coded.frame(index)
        return Frame(index, coded.original.timestamp_s, coded.decoded)

    @property
    def keyframe_image(self) -> Callable[[int], Image] | None:
        """Under `atc`, the image that mapping sees of a keyframe; None under `cta`."""
        return None if self._sender is None else self._decoded_keyframe

    def sent_size_bytes(self) -> int:
        """Bytes that the device has sent: under `atc` of the requested keyframes, else of all frames.

        Over a link, all bytes that were given to it.
        """
        if self._delivery is not None:
            return int(self._delivery.sent_bytes[self._all.start :].sum())
        if self._sender is None:
            return sum(self._coded.size_bytes(index) for index in self._all)
        return sum(self._sizes_bytes.values())

    def _decoded_keyframe(self, index: int) -> Image:
        """The decoded keyframe. One that is requested again is sent once."""
        assert self._sender is not None
        sent = self._sender.send(index)
        self._sizes_bytes[index] = sent.size_bytes
        return sent.decoded
