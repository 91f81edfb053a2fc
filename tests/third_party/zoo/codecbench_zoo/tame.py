"""What the misbehaving plugins would be if they behaved. A matrix calls each by its class: `returns_none`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, ClassVar

import numpy as np

from codecbench import (
    NULL_TRACE,
    Camera,
    Capabilities,
    Codec,
    CodedFrame,
    Dataset,
    Frame,
    FrameEvaluator,
    FrameSequence,
    Image,
    Measurement,
    Metric,
    NoParams,
    SlamBackend,
    SlamRun,
    Trace,
    TrackedFrame,
    Trajectory,
)
from codecbench_zoo.cases import snake


class TameCodec(Codec[Any]):
    """Keeps the upper half of each sample."""

    version = "1"
    params_type = NoParams
    capabilities = Capabilities(channels=(1,))

    def __init_subclass__(cls) -> None:
        cls.name = snake(cls.__name__)

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> Any:
        height, width = image.shape
        return height.to_bytes(2, "big") + width.to_bytes(2, "big") + (image & 0xF0).tobytes()

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Any:
        shape = int.from_bytes(bitstream[:2], "big"), int.from_bytes(bitstream[2:4], "big")
        return np.frombuffer(bitstream[4:], np.uint8).reshape(shape).copy()


class TameSequence(FrameSequence):
    """Three gray frames of 64x48."""

    frame_rate_hz, channels, camera, ground_truth = 10.0, 1, None, None

    def __init__(self, name: str) -> None:
        self.name = self.fingerprint = name
        self.timestamps_s = np.arange(3) / 10.0

    def read(self, index: int) -> Any:
        image = np.arange(48 * 64, dtype=np.int64).reshape(48, 64) % (50 + index)
        return Frame(index, float(self.timestamps_s[index]), image.astype(np.uint8))


class TameDataset(Dataset[Any]):
    """Opens a tame sequence of its own name."""

    version = "1"
    params_type = NoParams

    def __init_subclass__(cls) -> None:
        cls.name = snake(cls.__name__)

    def open(self) -> Any:
        return TameSequence(self.name)


class TameEvaluator(FrameEvaluator[Any]):
    """Weighs each frame."""

    version = "1"
    params_type = NoParams
    metrics: ClassVar[tuple[Metric, ...]] = (
        Metric("weight_bytes", "bytes", "lower", "size of the bitstream", headline=True),
        Metric("gain", "1", "higher", "beside the baseline", headline=True),
    )

    def __init_subclass__(cls) -> None:
        cls.name = snake(cls.__name__)
        super().__init_subclass__()

    def evaluate(self, coded: CodedFrame) -> Any:
        yield Measurement("weight_bytes", coded.size_bytes)


class TameBackend(SlamBackend[Any]):
    """Says that the camera went straight ahead."""

    version = "1"
    params_type = NoParams
    architectures = frozenset({"cta", "atc"})

    def __init_subclass__(cls) -> None:
        cls.name = snake(cls.__name__)

    def run(
        self,
        frames: Iterable[Frame],
        camera: Camera,
        *,
        seed: int,
        keyframe_image: Callable[[int], Image] | None = None,
    ) -> Any:
        return straight_run([(frame.index, frame.timestamp_s) for frame in frames])


def straight_run(stamps: list[tuple[int, float]], **changed: Any) -> SlamRun:
    """A run along the optical axis, with some of its fields changed."""
    times_s = np.array([time_s for _, time_s in stamps])
    poses = np.tile(np.eye(4), (len(stamps), 1, 1))
    poses[:, 2, 3] = times_s
    path = Trajectory(times_s, poses)
    fields: dict[str, Any] = {
        "frames": tuple(TrackedFrame(index, time_s, "tracked", inliers=50) for index, time_s in stamps),
        "trajectory": path,
        "trajectory_before_loops": path,
        "keyframe_indices": np.array([stamps[0][0]]),
        "points_world": np.zeros((5, 3)),
        "loops": (),
        "maps": 1,
    }
    return SlamRun(**{**fields, **changed})


def measurements(metric: str, *values: Any) -> Iterator[Measurement]:
    """One measurement for each value."""
    return (Measurement(metric, value) for value in values)
