"""The whole system: frames in, trajectory and map out."""

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
from codecbench.slam.mapping.mapper import use_decoded
from codecbench.slam.options import Options
from codecbench.slam.result import ClosedLoop, FrameState, FrameTrajectory, Result, State
from codecbench.slam.tracking.relocalization import Localizer

KeyframeImage = Callable[[ImageArray], ImageArray]


@dataclass(frozen=True)
class BuiltMap:
    """The largest map of a run: its localizer, the `trajectory` of the frames in it, and of which frames (K,) its
    keyframes are."""

    localizer: Localizer
    trajectory: FrameTrajectory
    keyframe_indices: NDArray[np.int64]


class System:
    """Monocular SLAM: `process` each frame in order (or `process_keypoints`), then `finish`.

    `camera` says how the images are projected, `options` what may be chosen, `seed` drives all that is drawn at random.
    The same frames and seed give the same result to the last bit. OpenCV's number of threads is one while a frame is
    processed and what the caller had set afterwards.
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
        self._mapping: Iterator[None] = iter(())  # steps that the newest keyframe has left to do

    def process(self, image: ImageArray, timestamp_s: float, keyframe_image: KeyframeImage | None = None) -> FrameState:
        """Look at one frame and say what became of it.

        `image` (height, width) gray or (height, width, 3) RGB, uint8; `timestamp_s` above the last one's.
        With `keyframe_image`, tracking sees `image`, and what becomes a keyframe is replaced by
        `keyframe_image(image)`: its features serve mapping, relocalisation and loop closing. Returns the frame's state;
        "refused" with the reason for an image or a time that cannot be used. In the result, a frame whose map was
        dropped since then has no pose. Raises TypeError for images that are not uint8 arrays of two or three
        dimensions.
        """
        with _one_thread():
            gray = to_gray(image)
            decode = None if keyframe_image is None else lambda: self._extract_decoded(keyframe_image(image))
            return self._take(
                (gray.shape[1], gray.shape[0]), timestamp_s, lambda: self._extractor.extract(gray), decode
            )

    def process_keypoints(self, found: Keypoints, timestamp_s: float) -> FrameState:
        """Look at one frame of which only the keypoints are here, as `FeatureExtractor.find` gives them.

        They are of a pyramid as `options` has it, in its order. Otherwise as `process`: keypoints of a frame give what
        the frame gives. Raises ValueError for more keypoints than `options.features`.
        """
        if len(found) > self.options.features:
            raise ValueError(
                f"{len(found)} keypoints; Options.features allows {self.options.features}: set it to that many"
            )
        with _one_thread():
            return self._take(found.size, timestamp_s, lambda: self._extractor.features_of(found))

    @property
    def maps(self) -> tuple[Map, ...]:
        """The maps as they are now, in the order in which they were started."""
        return tuple(tracked_map.map for tracked_map in self._atlas.maps)

    def finish(self) -> Result:
        """The result of all frames so far, after a last adjustment of each map where the options ask for it."""
        self._finish_mapping()
        maps = [tracked_map.finish(self.options.final_bundle_adjustment) for tracked_map in self._atlas.maps]
        maps.sort(key=lambda result: (-len(result.trajectory), result.index))
        frames = tuple(replace(state, map_index=self._atlas.final_index(state.map_index)) for state in self._frames)
        return Result(frames, tuple(self._loops), tuple(maps), tuple(self._atlas.merged))

    def _take(
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
        refusal = self._refusal(size, timestamp_s)
        if refusal:
            return FrameState(index, timestamp_s, "refused", reason=refusal)
        self._last_s = timestamp_s
        frame = TrackingFrame.of(index, timestamp_s, features(), decode)
        next(self._mapping, None)
        active = self._atlas.active
        if active is not None and (inliers := active.track(frame)):
            objection = active.objection(frame)
            if not objection:
                return self._tracked(frame, inliers, active)
            self._drop(active, objection)
            return self._initialize(frame)
        self._finish_mapping()
        if inliers := self._atlas.find(frame):
            assert self._atlas.active is not None
            return self._tracked(frame, inliers, self._atlas.active)
        return self._initialize(frame)

    def _refusal(self, size: tuple[int, int], timestamp_s: float) -> str:
        """Why a frame of this width and height cannot be used; empty when it can."""
        if size != (self.camera.width, self.camera.height):
            return f"an image of {size[0]}x{size[1]} where the camera has {self.camera.width}x{self.camera.height}"
        if not math.isfinite(timestamp_s) or timestamp_s <= self._last_s:
            return f"timestamp {timestamp_s} s is not after the last one, {self._last_s} s"
        return ""

    def _initialize(self, tracked: TrackingFrame) -> FrameState:
        """Try to start a map from a frame that no map is tracked in; what `tracked` seemed to show is left out."""
        frame = TrackingFrame.of(tracked.index, tracked.timestamp_s, tracked.features, tracked.decode)
        started = self._initializer.add(frame, self._atlas.started)
        if isinstance(started, str):
            state: State = "lost" if self._atlas.maps else "not_initialized"
            return FrameState(frame.index, frame.timestamp_s, state, reason=started)
        slam_map, mapper = started
        self._atlas.start(slam_map, mapper, frame)
        inliers = len(frame.matched)
        return FrameState(frame.index, frame.timestamp_s, "tracked", inliers, True, slam_map.index)

    def _tracked(self, frame: TrackingFrame, inliers: int, active: TrackedMap) -> FrameState:
        self._initializer.restart()
        keyframe = active.wants_keyframe(frame, inliers)
        if keyframe:
            self._finish_mapping()
            self._mapping = self._map(frame, active)
            next(self._mapping)
        else:
            active.record(frame)
        return FrameState(frame.index, frame.timestamp_s, "tracked", inliers, keyframe, active.map.index)

    def _map(self, frame: TrackingFrame, active: TrackedMap) -> Iterator[None]:
        """Make `frame` a keyframe of the active map, in steps: the first now, each other one before the next frame is
        tracked, so that no frame bears them all. What is left is done at once where a keyframe follows so soon, where
        the camera is lost, and in the end."""
        use_decoded(frame, self._extractor.scale_factors)
        active.insert(frame)
        yield
        active.settle(frame)
        yield
        if not self.options.loop_closing:
            return
        loop = active.close_loop(frame.reference)
        if loop is not None:
            self._loops.append(loop)
        else:
            self._atlas.merge(frame)

    def _drop(self, active: TrackedMap, objection: str) -> None:
        """Forget a map that turned out to be none, and the poses in it."""
        self._mapping = iter(())
        self._atlas.drop()
        state: State = "lost" if self._atlas.maps else "not_initialized"
        for place, frame in enumerate(self._frames):
            if frame.state == "tracked" and frame.map_index == active.map.index:
                self._frames[place] = replace(frame, state=state, inliers=0, reason=objection)

    def _finish_mapping(self) -> None:
        with _one_thread():
            for _ in self._mapping:
                pass

    def _extract_decoded(self, image: ImageArray) -> Features:
        gray = to_gray(image)
        if gray.shape != (self.camera.height, self.camera.width):
            raise ValueError(
                f"keyframe_image: returned {gray.shape[1]}x{gray.shape[0]}, "
                f"where the camera has {self.camera.width}x{self.camera.height}"
            )
        return self._extractor.extract(gray)


@contextmanager
def _one_thread() -> Iterator[None]:
    """OpenCV works in one thread, and afterwards in as many as before."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def build_map(
    frames: Iterable[tuple[ImageArray, float]], camera: Camera, options: Options | None = None, seed: int = 0
) -> BuiltMap | None:
    """The largest map that SLAM makes of images with their times in seconds, or None where it makes none."""
    options = options or Options()
    system = System(camera, options, seed)
    for image, timestamp_s in frames:
        system.process(image, timestamp_s)
    result = system.finish()
    if not result.maps:
        return None
    slam_map = next(found for found in system.maps if found.index == result.main.index)
    return BuiltMap(Localizer(slam_map, camera, options), result.trajectory, result.keyframe_indices)
