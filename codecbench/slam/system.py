"""The SLAM system: frames in, trajectory and map out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.slam.atlas import Atlas, TrackedMap
from codecbench.slam.features.extractor import FeatureExtractor, Features, ImageArray, Keypoints, to_gray
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import Map
from codecbench.slam.mapping.initialization import Initializer
from codecbench.slam.mapping.mapper import use_decoded_features
from codecbench.slam.options import Options
from codecbench.slam.result import ClosedLoop, FrameState, FrameTrajectory, Result, State
from codecbench.slam.tracking.relocalization import Localizer

KeyframeImage = Callable[[ImageArray], ImageArray]


@dataclass(frozen=True)
class BuiltMap:
    """The largest map of a run, ready to localize frames."""

    localizer: Localizer
    trajectory: FrameTrajectory
    """Poses of the frames tracked in the map."""
    keyframe_indices: NDArray[np.int64]
    """Frame indices (K,) of the map's keyframes."""


class System:
    """Monocular SLAM: call `process` (or `process_keypoints`) for each frame in order, then `finish`.

    `camera` is the camera model, `options` are the settings, and `seed` drives all random draws. The same frames and
    seed give the same result to the last bit. OpenCV runs one thread while a frame is processed; the caller's number of
    threads is restored.
    """

    def __init__(self, camera: Camera, options: Options | None = None, seed: int = 0) -> None:
        self.camera = camera
        self.options = options or Options()
        self._extractor = FeatureExtractor(camera, self.options)
        self._rng = np.random.default_rng(seed)
        factors = self._extractor.scale_factors
        self._initializer = Initializer(camera, factors, self.options.features, self._rng)
        self._atlas = Atlas(camera, self._rng)
        self._frames: list[FrameState] = []
        self._loops: list[ClosedLoop] = []
        self._last_s = -math.inf
        self._mapping: Iterator[None] = iter(())  # remaining steps of the newest keyframe

    def process(self, image: ImageArray, timestamp_s: float, keyframe_image: KeyframeImage | None = None) -> FrameState:
        """Process one frame and return its state.

        `image` is (height, width) gray or (height, width, 3) RGB, uint8; `timestamp_s` must exceed the last one. With
        `keyframe_image`, tracking uses `image`; if the frame becomes a keyframe, features of `keyframe_image(image)`
        replace its own for mapping, relocalization and loop closing. The state is "refused", with the reason, if the
        image's size or the time cannot be used. A frame whose map is dropped later has no pose in the result. Raises
        TypeError unless the image is a uint8 array of two or three dimensions.
        """
        with _single_opencv_thread():
            gray = to_gray(image)
            decode = None if keyframe_image is None else lambda: self._extract_decoded(keyframe_image(image))
            return self._process_and_record(
                (gray.shape[1], gray.shape[0]), timestamp_s, lambda: self._extractor.extract(gray), decode
            )

    def process_keypoints(self, keypoints: Keypoints, timestamp_s: float) -> FrameState:
        """Process one frame given only its keypoints, as `FeatureExtractor.find` returns them.

        They must come from a pyramid with these `options`, in its order; they then give what `process` gives for the
        frame. Raises ValueError if there are more than `options.features`.
        """
        if len(keypoints) > self.options.features:
            raise ValueError(
                f"{len(keypoints)} keypoints; Options.features allows {self.options.features}: set it to that many"
            )
        with _single_opencv_thread():
            return self._process_and_record(keypoints.size, timestamp_s, lambda: self._extractor.features_of(keypoints))

    @property
    def maps(self) -> tuple[Map, ...]:
        """The current maps, in the order in which they were started."""
        return tuple(tracked_map.map for tracked_map in self._atlas.maps)

    def finish(self) -> Result:
        """Return the result of all frames so far, after a final adjustment of each map if the options ask for it."""
        self._finish_mapping()
        maps = [tracked_map.finish(self.options.final_bundle_adjustment) for tracked_map in self._atlas.maps]
        maps.sort(key=lambda result: (-len(result.trajectory), result.index))
        frames = tuple(replace(state, map_index=self._atlas.surviving_index(state.map_index)) for state in self._frames)
        return Result(frames, tuple(self._loops), tuple(maps), tuple(self._atlas.merges))

    def _process_and_record(
        self,
        size: tuple[int, int],
        timestamp_s: float,
        features: Callable[[], Features],
        decode: Callable[[], Features] | None = None,
    ) -> FrameState:
        state = self._process(size, float(timestamp_s), features, decode)
        self._frames.append(state)
        return state

    def _process(
        self,
        size: tuple[int, int],
        timestamp_s: float,
        features: Callable[[], Features],
        decode: Callable[[], Features] | None,
    ) -> FrameState:
        index = len(self._frames)
        refusal = self._refusal_reason(size, timestamp_s)
        if refusal:
            return FrameState(index, timestamp_s, "refused", reason=refusal)
        self._last_s = timestamp_s
        frame = TrackingFrame.of(index, timestamp_s, features(), decode)
        next(self._mapping, None)
        active = self._atlas.active
        if active is not None and (inliers := active.track(frame)):
            rejection_reason = active.rejection_reason(frame)
            if not rejection_reason:
                return self._finish_tracked(frame, inliers, active)
            self._drop_map(active, rejection_reason)
            return self._initialize(frame)
        self._finish_mapping()
        if inliers := self._atlas.relocalize(frame):
            assert self._atlas.active is not None
            return self._finish_tracked(frame, inliers, self._atlas.active)
        return self._initialize(frame)

    def _refusal_reason(self, size: tuple[int, int], timestamp_s: float) -> str:
        """Return why a frame of this width and height cannot be used, or an empty string."""
        if size != (self.camera.width, self.camera.height):
            return f"the image is {size[0]}x{size[1]}, the camera {self.camera.width}x{self.camera.height}"
        if not math.isfinite(timestamp_s) or timestamp_s <= self._last_s:
            return f"timestamp {timestamp_s} s is not after the last one, {self._last_s} s"
        return ""

    def _initialize(self, untracked: TrackingFrame) -> FrameState:
        """Try to start a map from a frame that no map could track, without the points matched to it."""
        frame = TrackingFrame.of(untracked.index, untracked.timestamp_s, untracked.features, untracked.decode)
        outcome = self._initializer.add(frame, self._atlas.started_count)
        if isinstance(outcome, str):
            state: State = "lost" if self._atlas.maps else "not_initialized"
            return FrameState(frame.index, frame.timestamp_s, state, reason=outcome)
        slam_map, mapper = outcome
        self._atlas.start(slam_map, mapper, frame)
        inliers = len(frame.matched_features)
        return FrameState(frame.index, frame.timestamp_s, "tracked", inliers, True, slam_map.index)

    def _finish_tracked(self, frame: TrackingFrame, inliers: int, active: TrackedMap) -> FrameState:
        self._initializer.restart()
        keyframe = active.wants_keyframe(frame, inliers)
        if keyframe:
            self._finish_mapping()
            self._mapping = self._mapping_steps(frame, active)
            next(self._mapping)
        else:
            active.record(frame)
        return FrameState(frame.index, frame.timestamp_s, "tracked", inliers, keyframe, active.map.index)

    def _mapping_steps(self, frame: TrackingFrame, active: TrackedMap) -> Iterator[None]:
        """Make `frame` a keyframe of the active map, in steps.

        The first step runs now, each other one before the next frame is tracked, so that no frame bears the whole cost.
        The remaining steps run at once if a keyframe follows sooner, if the camera is lost, and in the end.
        """
        use_decoded_features(frame, self._extractor.scale_factors)
        active.insert(frame)
        yield
        active.refine_neighborhood(frame)
        yield
        if not self.options.loop_closing:
            return
        loop = active.close_loop(frame.reference)
        if loop is not None:
            self._loops.append(loop)
        else:
            self._atlas.merge(frame)

    def _drop_map(self, active: TrackedMap, rejection_reason: str) -> None:
        """Drop a map that turned out to be a false start, and the poses in it."""
        self._mapping = iter(())
        self._atlas.drop()
        state: State = "lost" if self._atlas.maps else "not_initialized"
        for position, frame in enumerate(self._frames):
            if frame.state == "tracked" and frame.map_index == active.map.index:
                self._frames[position] = replace(frame, state=state, inliers=0, reason=rejection_reason)

    def _finish_mapping(self) -> None:
        with _single_opencv_thread():
            for _ in self._mapping:
                pass

    def _extract_decoded(self, image: ImageArray) -> Features:
        gray = to_gray(image)
        if gray.shape != (self.camera.height, self.camera.width):
            raise ValueError(
                f"keyframe_image: returned {gray.shape[1]}x{gray.shape[0]}; "
                f"the camera has {self.camera.width}x{self.camera.height}"
            )
        return self._extractor.extract(gray)


@contextmanager
def _single_opencv_thread() -> Iterator[None]:
    """Limit OpenCV to one thread, then restore the number of threads."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def build_map(
    frames: Iterable[tuple[ImageArray, float]], camera: Camera, options: Options | None = None, seed: int = 0
) -> BuiltMap | None:
    """Return the largest map that SLAM makes of images with their times in seconds, or None if it makes none."""
    options = options or Options()
    system = System(camera, options, seed)
    for image, timestamp_s in frames:
        system.process(image, timestamp_s)
    result = system.finish()
    if not result.maps:
        return None
    slam_map = next(candidate for candidate in system.maps if candidate.index == result.main.index)
    return BuiltMap(Localizer(slam_map, camera, options), result.trajectory, result.keyframe_indices)
