"""The atlas: all maps of a run, each with its tracker, mapper and loop detector."""

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
from codecbench.slam.mapping.map_merging import absorb_map
from codecbench.slam.mapping.mapper import Mapper
from codecbench.slam.mapping.trial import Trial
from codecbench.slam.places.recognition import PlaceRecognition, relocalization_candidates
from codecbench.slam.result import ClosedLoop, FrameTrajectory, MapResult, MergedMaps
from codecbench.slam.tracking import keyframe_policy
from codecbench.slam.tracking.relocalization import relocalize
from codecbench.slam.tracking.tracked_pose import TrackedPose, transform_camera
from codecbench.slam.tracking.tracker import Tracker


class TrackedMap:
    """A map with its tracker, mapper, loop detector, and the frames tracked in it."""

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
        self._uncorrected_from_map = np.eye(4)  # similarity to the coordinates before any loop correction

    def start(self, frame: TrackingFrame) -> None:
        """Continue from `frame`, the map's newest keyframe."""
        frame.synchronize(self.map)
        self._tracker.start(frame)
        self._last_keyframe_frame = frame.index
        self.record(frame)

    def track(self, frame: TrackingFrame) -> int:
        """Find the pose of `frame` from the frame before; returns the inliers, 0 if it is lost."""
        return self._tracker.track(frame)

    def rejection_reason(self, frame: TrackingFrame) -> str:
        """Return why this young map is to be dropped, judged by `frame`, tracked in it; empty if it may stay."""
        return self._trial.rejection_reason(frame)

    @property
    def places(self) -> PlaceRecognition:
        """Place recognition over the map's keyframes."""
        return self._mapper.places

    def relocalize(self, frame: TrackingFrame, keyframe: int) -> int:
        """Find the pose of `frame` from a similar keyframe; returns the inliers, 0 if it stays lost."""
        return relocalize(frame, self._tracker, keyframe)

    def wants_keyframe(self, frame: TrackingFrame, inliers: int) -> bool:
        """Return whether the keyframe policy makes `frame`, tracked on `inliers` points, a keyframe."""
        table, reference = self.map.keyframes, frame.reference
        points = table.points[reference]
        center = np.asarray(se3_inverse(frame.camera_from_world))[:3, 3]
        baseline = float(np.linalg.norm(center - table.centers_world[reference]))
        depth = max(self._mapper.median_depth(reference), 1e-12)  # points behind the camera count as nearest
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
        """Make `frame` a keyframe; `refine_neighborhood` must follow before another frame is tracked."""
        self._mapper.insert(frame)
        self._last_keyframe_frame = frame.index

    def refine_neighborhood(self, frame: TrackingFrame) -> None:
        """Adjust the map around `frame`, its newest keyframe, and give `frame` its pose and points there."""
        self._mapper.refine_neighborhood(frame.reference)
        frame.synchronize(self.map)
        self.record(frame)

    def close_loop(self, keyframe: int) -> ClosedLoop | None:
        """Close the loop at the newest keyframe, if there is one; corrects the map and the last frame."""
        if keyframe - self._last_loop_keyframe < thresholds.LOOP_MIN_GAP_KEYFRAMES:
            return None
        loop = self._detector.detect(keyframe)
        if loop is None:
            return None
        self._correct(loop)
        frame_indices = self.map.keyframes.frame_indices
        return ClosedLoop(int(frame_indices[keyframe]), int(frame_indices[loop.matched_keyframe]), loop.inliers)

    def _correct(self, loop: Loop) -> None:
        last = self._tracker.last
        assert last is not None
        pose = self._tracked_pose(last)
        self._last_loop_keyframe = self.map.keyframes.count - 1
        before_from_after = close_loop(self.map, self._camera, loop)
        last.camera_from_world = np.asarray(se3_inverse(pose.resolve(self.map)))
        self._uncorrected_from_map = np.asarray(sim3_compose(self._uncorrected_from_map, before_from_after))

    def absorb(self, other: TrackedMap, loop: Loop) -> None:
        """Merge another map into this one; in `loop`, a keyframe of this map shows a place of the other.

        Poses as tracked in either map are in the coordinates that this map had before the two were adjusted to each
        other. Do not use `other` afterwards.
        """
        self._trial.end()
        self.map.index = min(self.map.index, other.map.index)
        absorbed = absorb_map(self._mapper, other._mapper, loop)
        new_from_other = sim3_compose(self._uncorrected_from_map, absorbed.map_from_other)
        new_from_old = np.asarray(sim3_compose(new_from_other, sim3_inverse(other._uncorrected_from_map)))
        moved = [pose.move_to_map(absorbed.numbers, absorbed.first_point, new_from_old) for pose in other._poses]
        self._poses = sorted(self._poses + moved, key=lambda pose: pose.index)
        self._correct(absorbed.loop)

    def record(self, frame: TrackingFrame) -> None:
        """Store the pose of a tracked frame."""
        self._poses.append(self._tracked_pose(frame))

    def _tracked_pose(self, frame: TrackingFrame) -> TrackedPose:
        world_from_camera = transform_camera(
            self._uncorrected_from_map, np.asarray(se3_inverse(frame.camera_from_world))
        )
        return TrackedPose.of(frame, self.map, world_from_camera)

    def finish(self, adjust: bool) -> MapResult:
        """Return the result of this map; `adjust` asks for a final adjustment of the map, then of its frames."""
        if adjust:
            adjust_map(self.map, self._camera)
            self._poses = [pose.refine(self.map, self._camera) for pose in self._poses]
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
    """All maps of a run in the order of their starts; `active` is the one that is tracked in, or None.

    Source of the name and the idea: ORBSLAM-Atlas (Elvira, Tardos, Montiel, IROS 2019).
    """

    def __init__(self, camera: Camera, rng: np.random.Generator) -> None:
        self.maps: list[TrackedMap] = []
        self.active: TrackedMap | None = None
        self.merges: list[MergedMaps] = []
        self.started_count = 0
        self._camera = camera
        self._rng = rng
        self._detectors: dict[int, LoopDetector] = {}  # by the other map's index: detects its places in the active map

    def start(self, slam_map: Map, mapper: Mapper, frame: TrackingFrame) -> None:
        """Continue in a new map whose newest keyframe is `frame`."""
        self.started_count += 1
        self.maps.append(TrackedMap(slam_map, mapper, self._camera, self._rng))
        self._activate(self.maps[-1])
        self.maps[-1].start(frame)

    def drop(self) -> None:
        """Drop the active map: it is neither tracked in nor searched any more."""
        self.maps = [tracked_map for tracked_map in self.maps if tracked_map is not self.active]
        self._activate(None)

    def relocalize(self, frame: TrackingFrame) -> int:
        """Relocalize a lost frame in any map and continue in that map; returns the inliers, 0 if it stays lost.

        The RELOCALIZATION_CANDIDATES most similar keyframes are tried, whatever the number of maps.
        """
        maps = sorted(self.maps, key=lambda tracked_map: tracked_map is not self.active)
        ranked = relocalization_candidates(frame.features, [tracked_map.places for tracked_map in maps])
        for place, keyframe in ranked[: thresholds.RELOCALIZATION_CANDIDATES]:
            if inliers := maps[place].relocalize(frame, keyframe):
                self._activate(maps[place])
                return inliers
        return 0

    def merge(self, frame: TrackingFrame) -> None:
        """Merge another map into the active one if `frame`, its newest keyframe, shows a place of that map.

        Maps of SMALL_MAP_KEYFRAMES or fewer are left alone.
        """
        active = self.active
        assert active is not None
        for other in self.maps:
            if other is active or len(other.map.alive_keyframes) <= thresholds.SMALL_MAP_KEYFRAMES:
                continue  # a map that was lost so soon may be a false start
            index, other_index = active.map.index, other.map.index
            if other_index not in self._detectors:
                self._detectors[other_index] = LoopDetector(active.places, other.places, self._camera, self._rng)
            loop = self._detectors[other_index].detect(frame.reference)
            if loop is None:
                continue
            matched = int(other.map.keyframes.frame_indices[loop.matched_keyframe])
            merged_index, gone_index = min(index, other_index), max(index, other_index)
            self.merges.append(MergedMaps(frame.index, matched, loop.inliers, merged_index, gone_index))
            active.absorb(other, loop)
            self.maps = [tracked_map for tracked_map in self.maps if tracked_map is not other]
            self._detectors.clear()
            return

    def surviving_index(self, index: int) -> int:
        """Return the index of the map that contains what was in map number `index`."""
        for merge in self.merges:
            index = merge.map_index if index == merge.gone_map_index else index
        return index

    def _activate(self, tracked_map: TrackedMap | None) -> None:
        if tracked_map is not self.active:
            self._detectors.clear()
        self.active = tracked_map
