"""All maps of a run: which is tracked in, where a lost camera is looked for, when two become one."""

from __future__ import annotations

import numpy as np

from codecbench.slam import thresholds
from codecbench.slam.atlas.tracked_map import TrackedMap
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import Map
from codecbench.slam.mapping.loop_detection import LoopDetector
from codecbench.slam.mapping.mapper import Mapper
from codecbench.slam.places.recognition import relocalization_candidates
from codecbench.slam.result import MergedMaps


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
