"""Sequences, coded sequences and contexts in memory, for tests of evaluators."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from codecbench.core.contracts.codec import Capabilities, Codec
from codecbench.core.contracts.evaluator import CodedFrame, Context, SentPacket
from codecbench.core.contracts.image import Image, layout_of
from codecbench.core.contracts.params import NoParams
from codecbench.core.contracts.sequence import Camera, Depth, Frame, FrameSequence, Trajectory
from codecbench.core.counting.trace import NULL_TRACE, Trace


class MemorySequence(FrameSequence):
    """Frames from a list of images at 10 Hz."""

    def __init__(
        self,
        images: list[Image],
        camera: Camera | None = None,
        ground_truth: Trajectory | None = None,
        depth: Depth | None = None,
    ) -> None:
        self.images = images
        self.name = "memory"
        self.timestamps_s = np.arange(len(images)) / 10.0
        self.frame_rate_hz = 10.0
        self.channels, self.bits = layout_of(images[0]) if images else (1, 8)
        self.depth = depth
        self.camera = camera
        self.ground_truth = ground_truth
        self.fingerprint = "memory"

    def read(self, index: int) -> Frame:
        return Frame(index, float(self.timestamps_s[index]), self.images[index])


class FunctionCodec(Codec[NoParams]):
    """A codec whose bitstream is the raw samples, decoded to whatever a function makes of the image."""

    name = "function"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities()

    def __init__(self, damage: Callable[[Image], Image] = lambda image: image) -> None:
        super().__init__(NoParams())
        self.damage = damage

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        return image.tobytes()

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        raise NotImplementedError("CodedInMemory applies `damage` itself")


class CodedInMemory:
    """A CodedSequence: every frame damaged by the codec when it is asked for."""

    def __init__(self, sequence: FrameSequence, codec: FunctionCodec | None = None) -> None:
        self.sequence = sequence
        self.codec: Any = codec or FunctionCodec()

    def __len__(self) -> int:
        return len(self.sequence)

    def __iter__(self) -> Iterator[CodedFrame]:
        return (self.frame(index) for index in range(len(self)))

    def frame(self, index: int) -> CodedFrame:
        original = self.sequence.read(index)
        return CodedFrame(original, self.codec.encode(original.image), self.codec.damage(original.image))

    def size_bytes(self, index: int) -> int:
        return self.frame(index).size_bytes

    @property
    def packets(self) -> tuple[SentPacket, ...]:
        return tuple(SentPacket(index, self.size_bytes(index), True, index + 1) for index in range(len(self)))

    def sender(self) -> CodedInMemory:
        return self

    def send(self, index: int) -> CodedFrame:
        return self.frame(index)


class Plugins:
    """A PluginSource of given objects, by kind and name; each is called with the parameters."""

    def __init__(self, **factories: Callable[[dict[str, Any]], Any]) -> None:
        self.factories = factories

    def create(self, kind: str, name: str, params: dict[str, Any]) -> Any:
        assert kind in ("slam_backend", "link")
        return self.factories[name](params)


def context(artifacts: Path, repeat: int = 0, plugins: Any = None) -> Context:
    return Context(np.random.default_rng(7), repeat, artifacts, plugins or Plugins())


def jpeg(image: Image, quality: int) -> Image:
    """What JPEG at this quality leaves of an image."""
    done, buffer = cv2.imencode(".jpg", image[..., ::-1] if image.ndim == 3 else image, [1, quality])
    assert done
    decoded = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
    return np.ascontiguousarray(decoded[..., ::-1] if image.ndim == 3 else decoded)


def textured(height: int, width: int, seed: int = 0) -> Image:
    """A gray picture with structure at many scales."""
    rng = np.random.default_rng(seed)
    picture = np.zeros((height, width))
    for sigma, weight in ((1.0, 1.0), (3.0, 3.0), (9.0, 9.0)):
        picture += weight * cv2.GaussianBlur(rng.standard_normal((height, width)), (0, 0), sigma)
    low, high = picture.min(), picture.max()
    return np.asarray((picture - low) / max(high - low, 1e-9) * 255.0, dtype=np.uint8)
