"""All maps of a run: which is tracked in, where a lost camera is looked for, when two become one."""

from __future__ import annotations

import numpy as np

from codecbench.slam import thresholds
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.geometry.transforms import se3_inverse, sim3_compose, sim3_inverse
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import Map
from codecbench.slam.mapping.loop_closing import adjust_map, close_loop
from codecbench.slam.mapping.loop_detection import Loop, LoopDetector
from codecbench.slam.mapping.map_merging import take_in
from codecbench.slam.mapping.mapper import Mapper
from codecbench.slam.mapping.trial import Trial
from codecbench.slam.places.recognition import PlaceRecognition, relocalization_candidates
from codecbench.slam.result import ClosedLoop, FrameTrajectory, MapResult, MergedMaps
from codecbench.slam.tracking import keyframe_policy
from codecbench.slam.tracking.relocalization import relocalize
from codecbench.slam.tracking.tracked_pose import TrackedPose, moved_camera
from codecbench.slam.tracking.tracker import Tracker


class TrackedMap:
    """A map that is being tracked in, or was."""

    def __init__(self, slam_map: Map, mapper: Mapper, camera: Camera, rng: np.random.Generator) -> None:
        self.map = slam_map
        self._poses: list[TrackedPose] = []
        self._camera = camera
        self._mapper = mapper
        self._tracker = Tracker(slam_map, camera)
        self._trial = Trial(slam_map, camera, rng)
        self._detector = LoopDetector(mapper.places, mapper.places, camera, rng)
        self._last_keyframe_frame = 0
        self._last_loop_keyframe = -thresholds.LOOP_MIN_GAP_KEYFRAMES
        self._uncorrected_from_map = np.eye(4)  # similarity: to the coordinates that no loop closing has moved

    def start(self, frame: TrackingFrame) -> None:
        """Go on from `frame`, the map's newest keyframe."""
        frame.synchronise(self.map)
        self._tracker.start(frame)
        self._last_keyframe_frame = frame.index
        self.record(frame)

    def track(self, frame: TrackingFrame) -> int:
        """Pose of `frame` from the one before; returns the inliers, 0 when it is lost."""
        return self._tracker.track(frame)

    def objection(self, frame: TrackingFrame) -> str:
        """Why this map, while it is young, is to be dropped, by `frame`, tracked in it; empty while it may stay."""
        return self._trial.objection(frame)

    @property
    def places(self) -> PlaceRecognition:
        """What the map's keyframes look like."""
        return self._mapper.places

    def relocalize(self, frame: TrackingFrame, keyframe: int) -> int:
        """Pose of `frame` from a keyframe that looks like it; returns the inliers, 0 when it stays lost."""
        return relocalize(frame, self._tracker, keyframe)

    def wants_keyframe(self, frame: TrackingFrame, inliers: int) -> bool:
        """Whether `frame`, tracked on `inliers` points, should become a keyframe: the keyframe policy says."""
        table, reference = self.map.keyframes, frame.reference
        points = table.points[reference]
        center = np.asarray(se3_inverse(frame.camera_from_world))[:3, 3]
        baseline = float(np.linalg.norm(center - table.centers_world[reference]))
        depth = max(self._mapper.median_depth(reference), 1e-12)  # points behind the camera: as near as can be
        return keyframe_policy.wants_keyframe(
            keyframe_policy.KeyframeEvidence(
                inliers=inliers,
                features=len(frame.features),
                reference_observations=self.map.points.observation_counts[points[points >= 0]],
                map_keyframes=len(self.map.alive_keyframes),
                since_keyframe_frames=frame.index - self._last_keyframe_frame,
                parallax=baseline / depth,
            )
        )

    def insert(self, frame: TrackingFrame) -> None:
        """Make `frame` a keyframe; `settle` must follow before another frame is tracked."""
        self._mapper.insert(frame)
        self._last_keyframe_frame = frame.index

    def settle(self, frame: TrackingFrame) -> None:
        """Adjust the map round `frame`, its newest keyframe, which gives it the pose and points that it has there."""
        self._mapper.settle(frame.reference)
        frame.synchronise(self.map)
        self.record(frame)

    def close_loop(self, keyframe: int) -> ClosedLoop | None:
        """The loop that the newest keyframe closes, if it does; the map and the last frame are corrected for it."""
        if keyframe - self._last_loop_keyframe < thresholds.LOOP_MIN_GAP_KEYFRAMES:
            return None
        loop = self._detector.detect(keyframe)
        if loop is None:
            return None
        self._correct(loop)
        frame_indices = self.map.keyframes.frame_indices
        return ClosedLoop(int(frame_indices[keyframe]), int(frame_indices[loop.matched]), loop.inliers)

    def _correct(self, loop: Loop) -> None:
        last = self._tracker.last
        assert last is not None
        held = self._held(last)
        self._last_loop_keyframe = self.map.keyframes.count - 1
        before_from_after = close_loop(self.map, self._camera, loop)
        last.camera_from_world = np.asarray(se3_inverse(held.resolve(self.map)))
        self._uncorrected_from_map = np.asarray(sim3_compose(self._uncorrected_from_map, before_from_after))

    def take_in(self, other: TrackedMap, seen: Loop) -> None:
        """Make another map, a place of which a keyframe of this one has `seen`, part of this one.

        What was tracked in either stands where this map was before the two were adjusted to each other. `other` is of
        no use afterwards.
        """
        self._trial.end()
        self.map.index = min(self.map.index, other.map.index)
        joint = take_in(self._mapper, other._mapper, seen)
        new_from_other = sim3_compose(self._uncorrected_from_map, joint.map_from_other)
        new_from_old = np.asarray(sim3_compose(new_from_other, sim3_inverse(other._uncorrected_from_map)))
        moved = [pose.moved(joint.numbers, joint.first_point, new_from_old) for pose in other._poses]
        self._poses = sorted(self._poses + moved, key=lambda pose: pose.index)
        self._correct(joint.loop)

    def record(self, frame: TrackingFrame) -> None:
        """Keep the pose of a tracked frame."""
        self._poses.append(self._held(frame))

    def _held(self, frame: TrackingFrame) -> TrackedPose:
        world_from_camera = moved_camera(self._uncorrected_from_map, np.asarray(se3_inverse(frame.camera_from_world)))
        return TrackedPose.of(frame, self.map, world_from_camera)

    def finish(self, adjust: bool) -> MapResult:
        """The result of this map, after a last adjustment of the map, and then of the frames to it, if so wanted."""
        if adjust:
            adjust_map(self.map, self._camera)
            self._poses = [pose.refined(self.map, self._camera) for pose in self._poses]
        keyframes, points = self.map.keyframes, self.map.points
        return MapResult(
            self.map.index,
            self._trajectory([pose.resolve(self.map) for pose in self._poses]),
            self._trajectory([pose.world_from_camera for pose in self._poses]),
            np.sort(keyframes.frame_indices[self.map.alive_keyframes]),
            points.positions[self.map.alive_points].copy(),
        )

    def _trajectory(self, world_from_camera: list[Array]) -> FrameTrajectory:
        return FrameTrajectory(
            np.array([pose.index for pose in self._poses], dtype=np.int64),
            np.array([pose.timestamp_s for pose in self._poses], dtype=np.float64),
            np.array(world_from_camera).reshape(-1, 4, 4),
        )


class Atlas:
    """The maps of a run in the order of their starts; `active` is the one that is tracked in, None while there is none.

    The name and the idea are those of ORBSLAM-Atlas (Elvira, Tardos, Montiel, IROS 2019).
    """

    def __init__(self, camera: Camera, rng: np.random.Generator) -> None:
        self.maps: list[TrackedMap] = []
        self.active: TrackedMap | None = None
        self.merged: list[MergedMaps] = []
        self.started = 0
        self._camera = camera
        self._rng = rng
        self._detectors: dict[int, LoopDetector] = {}  # by the other map's index: what the active one shows of it

    def start(self, slam_map: Map, mapper: Mapper, frame: TrackingFrame) -> None:
        """Go on in a new map, whose newest keyframe is `frame`."""
        self.started += 1
        self.maps.append(TrackedMap(slam_map, mapper, self._camera, self._rng))
        self._activate(self.maps[-1])
        self.maps[-1].start(frame)

    def drop(self) -> None:
        """Forget the active map: nothing is tracked or found in it any more."""
        self.maps = [kept for kept in self.maps if kept is not self.active]
        self._activate(None)

    def find(self, frame: TrackingFrame) -> int:
        """Look for a lost frame in all maps, and go on in the one that it is found in; returns the inliers, 0 when it
        stays lost.

        The keyframes that look most like it are tried, RELOCALIZATION_CANDIDATES of them whatever the number of maps.
        """
        maps = sorted(self.maps, key=lambda tracked_map: tracked_map is not self.active)
        ranked = relocalization_candidates(frame.features, [tracked_map.places for tracked_map in maps])
        for which, keyframe in ranked[: thresholds.RELOCALIZATION_CANDIDATES]:
            if inliers := maps[which].relocalize(frame, keyframe):
                self._activate(maps[which])
                return inliers
        return 0

    def merge(self, frame: TrackingFrame) -> None:
        """Take another map into the active one if `frame`, its newest keyframe, shows a place of that map.

        Maps of SMALL_MAP_KEYFRAMES or fewer are left alone.
        """
        active = self.active
        assert active is not None
        for other in self.maps:
            if other is active or len(other.map.alive_keyframes) <= thresholds.SMALL_MAP_KEYFRAMES:
                continue  # what was lost so soon may have been started wrongly
            index, other_index = active.map.index, other.map.index
            if other_index not in self._detectors:
                self._detectors[other_index] = LoopDetector(active.places, other.places, self._camera, self._rng)
            seen = self._detectors[other_index].detect(frame.reference)
            if seen is None:
                continue
            matched = int(other.map.keyframes.frame_indices[seen.matched])
            kept, gone = min(index, other_index), max(index, other_index)
            self.merged.append(MergedMaps(frame.index, matched, seen.inliers, kept, gone))
            active.take_in(other, seen)
            self.maps = [kept_map for kept_map in self.maps if kept_map is not other]
            self._detectors.clear()
            return

    def final_index(self, index: int) -> int:
        """The map in which what was in map number `index` is now."""
        for merged in self.merged:
            index = merged.map_index if index == merged.gone_map_index else index
        return index

    def _activate(self, tracked_map: TrackedMap | None) -> None:
        if tracked_map is not self.active:
            self._detectors.clear()
        self.active = tracked_map
