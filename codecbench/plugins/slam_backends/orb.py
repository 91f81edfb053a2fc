"""The `orb` backend: codecbench's own monocular ORB-SLAM, which is the independent package codecbench.slam.

This module converts between the two: `codecbench.slam` does not import the benchmark, so some types have a counterpart.

- `Camera` becomes a `slam.Camera`, which can project and undistort.
- `Frame` gives its gray image and its time to `System.process`, which makes a `TrackingFrame` of them.
- `FeatureFrame` gives its features as `Keypoints` to `System.process_keypoints`.
- `slam.FrameState` becomes a `TrackedFrame`, with the sequence's frame index in place of the count from 0, and the
  computing time of the frame.
- `slam.FrameTrajectory` becomes a `Trajectory`, without its frame indices.
- `slam.ClosedLoop` and `slam.MergedMaps` become `LoopEvent`s, with the sequence's frame indices.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Annotated, Any, TypeVar

import numpy as np
from numba.core import event
from numpy.typing import NDArray
from pydantic import Field

from codecbench import slam
from codecbench.core.contracts.errors import SlamError, Unsupported
from codecbench.core.contracts.features import FeatureFrame, Features
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import Camera, Frame, Trajectory
from codecbench.core.contracts.slam import LoopEvent, SlamBackend, SlamRun, TrackedFrame
from codecbench.plugins.slam_backends.keypoints import keypoints_of
from codecbench.slam.features.extractor import Keypoints
from codecbench.slam.system import BuiltMap, build_map

Step = Callable[[], slam.FrameState]
_F = TypeVar("_F", Frame, FeatureFrame)


class OrbParams(Params):
    """Set the ORB features and the optional steps of the SLAM.

    features: most ORB features in a frame. levels: pyramid levels. scale: ratio of two consecutive levels.
    loop_closing: whether to close loops and merge maps of one place. final_adjustment: whether bundle adjustment
    refines each map at the end.
    """

    features: Annotated[int, Field(ge=100, le=10_000)] = 1000
    levels: Annotated[int, Field(ge=1, le=16)] = 8
    scale: Annotated[float, Field(gt=1.0, le=2.0)] = 1.2
    loop_closing: bool = True
    final_adjustment: bool = True


class Orb(SlamBackend[OrbParams]):
    """Runs codecbench.slam. Equal frames and an equal seed give the same trajectory to the last bit."""

    name = "orb"
    version = "12"
    params_type = OrbParams
    architectures = frozenset({"cta", "atc", "features"})
    kernels = ("codecbench.slam",)

    def run(
        self,
        frames: Iterable[Frame],
        camera: Camera,
        *,
        seed: int,
        keyframe_image: Callable[[int], Image] | None = None,
    ) -> SlamRun:
        def make_step(system: slam.System, frame: Frame, clock: _Clock) -> Step:
            gray = gray_from_image(frame.image)
            keyframe_source = _keyframe_source(keyframe_image, frame.index, clock)
            return lambda: system.process(gray, frame.timestamp_s, keyframe_source)

        return self._run(frames, camera, seed, make_step)

    def run_features(self, frames: Iterable[FeatureFrame], camera: Camera, *, seed: int) -> SlamRun:
        def make_step(system: slam.System, frame: FeatureFrame, _: _Clock) -> Step:
            keypoints = self.keypoints(frame.features)
            return lambda: system.process_keypoints(keypoints, frame.timestamp_s)

        return self._run(frames, camera, seed, make_step)

    def keypoints(self, features: Features) -> Keypoints:
        """Features from elsewhere as keypoints. Raises Unsupported if they are more than the parameters allow."""
        params, count, levels = self.params, len(features), int(features.octaves.max(initial=0)) + 1
        if count > params.features or levels > params.levels:
            raise Unsupported(
                f"slam backend orb got {count} features of {levels} levels; backend_params allow {params.features} of "
                f"{params.levels}: raise features and levels"
            )
        return keypoints_of(features)

    def _run(
        self, frames: Iterable[_F], camera: Camera, seed: int, make_step: Callable[[slam.System, _F, _Clock], Step]
    ) -> SlamRun:
        """make_step: prepares a frame and returns the call to time."""
        system = slam.System(_camera(camera), self._options(), seed)
        clock = _Clock()
        indices: list[int] = []
        elapsed_ms: list[float] = []
        with event.install_listener("numba:compile", clock.compiling):
            for frame in frames:
                step = make_step(system, frame, clock)
                started = clock.ms()
                step()
                elapsed_ms.append(clock.ms() - started)
                indices.append(frame.index)
            if not indices:
                raise SlamError("orb got no frame")
            started = clock.ms()
            result = system.finish()
            # The time to finish is added to the last frame, so that the mean over frames is the cost of the run.
            elapsed_ms[-1] += clock.ms() - started
        return _slam_run(result, np.array(indices, dtype=np.int64), elapsed_ms)

    def map_of(self, frames: Iterable[Frame], camera: Camera, *, seed: int) -> BuiltMap | None:
        """The map that `run` makes of these frames, to locate other frames in; None if it makes none."""
        images = ((gray_from_image(frame.image), frame.timestamp_s) for frame in frames)
        return build_map(images, _camera(camera), self._options(), seed)

    def _options(self) -> slam.Options:
        return slam.Options(
            features=self.params.features,
            levels=self.params.levels,
            scale_factor=self.params.scale,
            loop_closing=self.params.loop_closing,
            final_bundle_adjustment=self.params.final_adjustment,
        )


def _camera(camera: Camera) -> slam.Camera:
    sizes = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return slam.Camera(*sizes, camera.distortion, camera.model)


class _Clock:
    """The computing time of SLAM, without compilation of kernels, once per machine, and without fetching images."""

    def __init__(self) -> None:
        self.compiling = event.TimingListener()  # type: ignore[no-untyped-call]
        self._fetching_ms = 0.0

    def ms(self) -> float:
        compiling_s = self.compiling.duration if self.compiling.done else 0.0
        return 1e3 * (time.perf_counter() - compiling_s) - self._fetching_ms

    def fetch(self, image: Callable[[int], Image], index: int) -> Image:
        started = self.ms()
        gray = gray_from_image(image(index))
        self._fetching_ms += self.ms() - started
        return gray


def _keyframe_source(
    keyframe_image: Callable[[int], Image] | None, index: int, clock: _Clock
) -> Callable[[Any], Any] | None:
    """A source of the image that mapping sees, in place of the tracked one, if this frame becomes a keyframe."""
    if keyframe_image is None:
        return None
    return lambda _: clock.fetch(keyframe_image, index)


def _slam_run(result: slam.Result, indices: NDArray[np.int64], elapsed_ms: list[float]) -> SlamRun:
    """Convert a result, with the sequence's frame indices in place of the system's count from 0."""
    frames = tuple(
        TrackedFrame(
            index=int(index),
            timestamp_s=state.timestamp_s,
            state=state.state,
            inliers=state.inliers,
            keyframe=state.keyframe,
            map_id=state.map_index,
            reason=state.reason,
            elapsed_ms=elapsed,
        )
        for state, index, elapsed in zip(result.frames, indices, elapsed_ms, strict=True)
    )
    loops = [
        LoopEvent(int(indices[event.frame_index]), int(indices[event.matched_frame_index]), event.inliers, merged_maps)
        for events, merged_maps in ((result.loops, False), (result.merges, True))
        for event in events
    ]
    return SlamRun(
        frames=frames,
        trajectory=_trajectory(result.trajectory),
        trajectory_before_loops=_trajectory(result.trajectory_before_loops),
        keyframe_indices=indices[result.keyframe_indices],
        points_world=result.points_world,
        loops=tuple(sorted(loops, key=lambda loop: loop.frame)),
        maps=len(result.maps),
    )


def _trajectory(trajectory: slam.FrameTrajectory) -> Trajectory:
    return Trajectory(trajectory.timestamps_s, trajectory.world_from_camera)
