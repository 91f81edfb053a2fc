"""The whole system: frames in, trajectory and map out."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds
from codecbench.slam.camera import Camera
from codecbench.slam.features import FeatureExtractor
from codecbench.slam.frame import Frame
from codecbench.slam.initialization import Initializer
from codecbench.slam.map import Map
from codecbench.slam.mapping import Mapper
from codecbench.slam.options import Options
from codecbench.slam.tracking import Tracker
from codecbench.slam.trajectory import FrameState, LoopEvent, Result, TrackedPose, summarize
from codecbench.slam.transforms import se3_inverse

ImageArray = NDArray[np.uint8]
KeyframeImage = Callable[[ImageArray], ImageArray]


class _Session:
    """One map with what works on it and the frames tracked in it."""

    def __init__(self, slam_map: Map, mapper: Mapper, tracker: Tracker) -> None:
        self.map = slam_map
        self.mapper = mapper
        self.tracker = tracker
        self.poses: list[TrackedPose] = []
        self.last_keyframe_s = -math.inf


class System:
    """Monocular SLAM: `process` each frame in order, then `finish`."""

    def __init__(self, camera: Camera, options: Options | None = None, seed: int = 0) -> None:
        self.camera = camera
        self.options = options or Options()
        self._extractor = FeatureExtractor(camera, self.options)
        self._initializer = Initializer(
            camera, self._extractor.scale_factors, self.options.features, np.random.default_rng(seed)
        )
        self._sessions: list[_Session] = []
        self._active: _Session | None = None
        self._frames: list[FrameState] = []
        self._loops: list[LoopEvent] = []
        self._lost_since_s = math.inf

    def process(
        self, image: ImageArray, timestamp_s: float, keyframe_image: KeyframeImage | None = None
    ) -> FrameState:
        """Look at one frame and say what became of it."""
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)
        try:
            state = self._process(image, float(timestamp_s), keyframe_image)
        finally:
            cv2.setNumThreads(threads)
        self._frames.append(state)
        return state

    def finish(self) -> Result:
        """What the run has found."""
        return summarize(self._frames, self._loops, [(s.map, s.poses) for s in self._sessions])

    def _process(self, image: ImageArray, timestamp_s: float, keyframe_image: KeyframeImage | None) -> FrameState:
        index = len(self._frames)
        gray = to_gray(image)
        frame = Frame.of(index, timestamp_s, self._extractor.extract(gray))
        if self._active is None:
            return self._initialize(frame)
        return self._track(frame, self._active)

    def _initialize(self, frame: Frame) -> FrameState:
        started = self._initializer.add(frame, len(self._sessions))
        if isinstance(started, str):
            return FrameState(frame.index, frame.timestamp_s, "not_initialized", reason=started)
        slam_map, mapper, _ = started
        session = _Session(slam_map, mapper, Tracker(slam_map, self.camera))
        session.tracker.start(frame)
        session.last_keyframe_s = frame.timestamp_s
        self._sessions.append(session)
        self._active = session
        inliers = len(frame.matched)
        self._record(session, frame)
        return FrameState(frame.index, frame.timestamp_s, "tracked", inliers, True, slam_map.index)

    def _track(self, frame: Frame, session: _Session) -> FrameState:
        inliers = session.tracker.track(frame)
        if inliers == 0:
            return FrameState(frame.index, frame.timestamp_s, "lost", 0, False, session.map.index, "lost")
        keyframe = self._wants_keyframe(frame, inliers, session)
        if keyframe:
            session.mapper.insert(frame)
            session.last_keyframe_s = frame.timestamp_s
        self._record(session, frame)
        return FrameState(frame.index, frame.timestamp_s, "tracked", inliers, keyframe, session.map.index)

    def _wants_keyframe(self, frame: Frame, inliers: int, session: _Session) -> bool:
        """Whether `frame` should become a keyframe (ORB-SLAM V-E)."""
        slam_map = session.map
        needed = min(thresholds.KEYFRAME_REFERENCE_OBSERVATIONS, len(slam_map.alive_keyframes))
        points = slam_map.keyframes.points[frame.reference]
        points = points[points >= 0]
        share = inliers / max(int((slam_map.points.observation_counts[points] >= needed).sum()), 1)
        elapsed_s = frame.timestamp_s - session.last_keyframe_s
        waited = elapsed_s >= thresholds.KEYFRAME_MIN_INTERVAL_S - 1e-3
        return share < thresholds.KEYFRAME_MAX_SHARE and (waited or share < thresholds.KEYFRAME_URGENT_SHARE)

    def _record(self, session: _Session, frame: Frame) -> None:
        slam_map = session.map
        pose = slam_map.keyframes.camera_from_world[frame.reference]
        session.poses.append(
            TrackedPose(
                frame.index, frame.timestamp_s, frame.reference, frame.camera_from_world @ se3_inverse(pose),
                slam_map.scale_of(frame.reference), se3_inverse(frame.camera_from_world),
            )  # fmt: skip
        )


def to_gray(image: NDArray[Any]) -> ImageArray:
    """The image in gray (height, width), by BT.601 where it has three channels, blue first."""
    if image.ndim == 2:
        return np.asarray(image, dtype=np.uint8)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
