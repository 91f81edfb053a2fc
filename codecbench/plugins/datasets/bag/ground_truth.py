"""The camera's ground truth, from poses or transforms in a recording."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
import scipy
from numpy.typing import NDArray

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Trajectory
from codecbench.plugins.datasets.bag.messages import (
    FIX,
    ODOMETRY,
    POSE,
    POSE_COVARIANCE,
    TRANSFORM,
    TRANSFORMS,
    stamp_ns,
)
from codecbench.plugins.datasets.bag.recording import Recording, Topic
from codecbench.plugins.datasets.tables import transforms_from_quaternions

Floats = NDArray[np.float64]
_POSE_NUMBERS: Final = 7
_MOST_ANCESTORS: Final = 100
_STATIC: Final = "tf_static"


@dataclass
class Edge:
    """The transforms parent_from_child of one frame."""

    parent: str
    is_static: bool
    times_ns: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))
    """Seven per time: position, then quaternion x, y, z, w."""

    def trajectory(self, where: str) -> Trajectory:
        """The transforms sorted by time; the first of several at one time counts. Raises DatasetError."""
        times_ns, first = np.unique(np.frombuffer(self.times_ns, np.int64), return_index=True)
        poses = np.frombuffer(self.numbers, np.float64).reshape(-1, _POSE_NUMBERS)[first]
        return Trajectory(
            times_ns / 1e9, transforms_from_quaternions(poses, lambda number: f"{where}[{first[number]}]")
        )

    def constant(self, where: str) -> Floats:
        """The transform (4, 4) of a static edge: the latest one."""
        return np.asarray(self.trajectory(where).world_from_camera[-1])


class FrameTree:
    """The tree of coordinate frames, from the transforms of a recording."""

    def __init__(self, recording: Recording, moving: Topic | None) -> None:
        """Read static transforms, and those of the topic `moving` if given. Raises DatasetError."""
        self.edges: dict[str, Edge] = {}
        self._where = str(recording.path)
        for topic in recording.topics.values():
            is_static = topic.name.rpartition("/")[2] == _STATIC
            if topic.kind == TRANSFORMS[0] and (is_static or topic is moving):
                for _, message in recording.messages(topic):
                    for transform in message.transforms:
                        self._add(transform, is_static)

    def static_between(self, parent: str, child: str) -> Floats | None:
        """parent_from_child (4, 4) by static transforms alone, or None if they do not connect the two frames."""
        (root, root_from_parent), (other, root_from_child) = self._static_root(parent), self._static_root(child)
        return np.linalg.inv(root_from_parent) @ root_from_child if root == other else None

    def path(self, parent: str | None, child: str) -> tuple[str, Trajectory]:
        """The name of the parent, and parent_from_child over time; without a parent, that of the tree's root.

        Times are those of the most frequent transform on the chain. The others are interpolated: positions linearly,
        rotations along the arc. Raises DatasetError if no chain connects the frames or nothing moves.
        """
        chain = self._ancestors(parent, child)
        top = self.edges[chain[-1]].parent if chain else child
        moving = {
            name: self.edges[name].trajectory(self._label(name)) for name in chain if not self.edges[name].is_static
        }
        if not moving:
            raise DatasetError(
                f"{self._where}: no moving transform between {top!r} and {child!r}; {self._describe_transforms()}"
            )
        start_s = max(path.timestamps_s[0] for path in moving.values())
        end_s = min(path.timestamps_s[-1] for path in moving.values())
        times_s = max((path.timestamps_s for path in moving.values()), key=len)
        times_s = times_s[(start_s <= times_s) & (times_s <= end_s)]
        if not len(times_s):
            raise DatasetError(f"{self._where}: the transforms between {top!r} and {child!r} are of different times")
        top_from_child = np.tile(np.eye(4), (len(times_s), 1, 1))
        for name in chain:
            edge = self.edges[name]
            poses = edge.constant(self._label(name)) if edge.is_static else interpolate_poses(moving[name], times_s)
            top_from_child = poses @ top_from_child
        return top, Trajectory(times_s, top_from_child)

    def _add(self, transform: Any, is_static: bool) -> None:
        child, parent = frame_name(transform.child_frame_id), frame_name(transform.header.frame_id)
        edge = self.edges.setdefault(child, Edge(parent, is_static))
        if edge.parent != parent:
            raise DatasetError(f"{self._where}: the frame {child!r} has two parents, {edge.parent!r} and {parent!r}")
        edge.times_ns.append(stamp_ns(transform.header))
        edge.numbers.extend(pose_numbers(transform.transform.translation, transform.transform.rotation))

    def _ancestors(self, parent: str | None, child: str) -> list[str]:
        """The chain of frames from the child up to the one below the parent. Raises DatasetError if there is none."""
        chain: list[str] = []
        frame = child
        while frame != parent and frame in self.edges and len(chain) < _MOST_ANCESTORS:
            chain.append(frame)
            frame = self.edges[frame].parent
        if len(chain) == _MOST_ANCESTORS or (parent is not None and frame != parent):
            raise DatasetError(
                f"{self._where}: no transforms lead from {parent!r} to {child!r}; {self._describe_transforms()}"
            )
        return chain

    def _static_root(self, frame: str) -> tuple[str, Floats]:
        """The topmost frame that static transforms connect to `frame`, and root_from_frame (4, 4)."""
        whole = np.eye(4)
        for _ in range(_MOST_ANCESTORS):
            edge = self.edges.get(frame)
            if edge is None or not edge.is_static:
                break
            whole, frame = edge.constant(self._label(frame)) @ whole, edge.parent
        return frame, whole

    def _label(self, child: str) -> str:
        return f"{self._where}: transforms of {child!r}"

    def _describe_transforms(self) -> str:
        pairs = ", ".join(f"{edge.parent} -> {child}" for child, edge in sorted(self.edges.items())[:30])
        return f"give `parent_frame` and `child_frame`; transforms: {pairs or 'none'}"


def interpolate_poses(path: Trajectory, times_s: Floats) -> Floats:
    """Interpolate the poses (N, 4, 4) of a path at times within it."""

    poses = np.tile(np.eye(4), (len(times_s), 1, 1))
    for axis in range(3):
        poses[:, axis, 3] = np.interp(times_s, path.timestamps_s, path.world_from_camera[:, axis, 3])
    rotations = scipy.spatial.transform.Rotation.from_matrix(path.world_from_camera[:, :3, :3])
    if len(path) == 1:
        poses[:, :3, :3] = rotations.as_matrix()
    else:
        poses[:, :3, :3] = scipy.spatial.transform.Slerp(path.timestamps_s, rotations)(times_s).as_matrix()
    return poses


def pose_numbers(position: Any, rotation: Any) -> tuple[float, ...]:
    """Position and quaternion of a message as x, y, z, qx, qy, qz, qw."""
    return (position.x, position.y, position.z, rotation.x, rotation.y, rotation.z, rotation.w)


def frame_name(text: str) -> str:
    """The name of a coordinate frame without the leading slash that ROS 1 allows."""
    return text.strip("\0").lstrip("/")


POSE_TYPES: Final = (POSE, POSE_COVARIANCE, TRANSFORM, ODOMETRY)
_TRUTH_KINDS: Final = (*POSE_TYPES, TRANSFORMS[0], FIX)
_EQUATOR_M: Final = 6378137.0
_ECCENTRICITY_2: Final = 0.00669437999014
_REMEDY: Final = "set `ground_truth: none` to use none"


@dataclass(frozen=True)
class PoseSource:
    """Which ground truth is requested."""

    topic: str
    """Name of a topic, `auto` or `none`."""
    parent_frame: str | None
    child_frame: str | None
    camera_frame: str
    """Coordinate frame of the images."""


def find_ground_truth(recording: Recording, pose_source: PoseSource) -> tuple[Trajectory | None, list[str]]:
    """The camera's poses over time, or None, and notes on them. Raises DatasetError."""
    if pose_source.topic == "none":
        return None, []
    if pose_source.topic == "auto":
        topic, notes = _only_topic(recording)
        if topic is None:
            return None, notes
    else:
        topic = _find_topic(recording, pose_source.topic)
    if topic.kind == TRANSFORMS[0]:
        return _path_from_transforms(recording, topic, pose_source)
    if topic.kind == FIX:
        return _path_from_fixes(recording, topic)
    return _path_from_poses(recording, topic, pose_source)


def _only_topic(recording: Recording) -> tuple[Topic | None, list[str]]:
    """The recording's topic of poses if there is exactly one, else None and a note."""
    poses = [topic for topic in recording.topics.values() if topic.kind in POSE_TYPES and len(topic)]
    if len(poses) == 1:
        return poses[0], []
    others = [
        topic
        for topic in recording.topics.values()
        if topic.kind in (TRANSFORMS[0], FIX) and not topic.name.endswith("tf_static")
    ]
    names = ", ".join(topic.name for topic in poses or others)
    if not names:
        return None, []
    return None, [f"no ground truth is used; set `ground_truth: TOPIC` to one of {names}"]


def _find_topic(recording: Recording, name: str) -> Topic:
    """The topic of poses or transforms called `name`. Raises DatasetError."""
    topic = recording.topics.get(name)
    if topic is None or not len(topic) or topic.kind not in _TRUTH_KINDS:
        names = [topic.name for topic in recording.topics.values() if topic.kind in _TRUTH_KINDS]
        what = "does not exist" if topic is None else f"has {len(topic)} messages of {topic.type}"
        raise DatasetError(
            f"{recording.path}: ground_truth {name!r} {what}; pose topics: {', '.join(names) or 'none'}; {_REMEDY}"
        )
    return topic


def _path_from_transforms(recording: Recording, topic: Topic, pose_source: PoseSource) -> tuple[Trajectory, list[str]]:
    child = frame_name(pose_source.child_frame or pose_source.camera_frame)
    tree = FrameTree(recording, topic)
    parent, path = tree.path(frame_name(pose_source.parent_frame) if pose_source.parent_frame else None, child)
    path, notes = _move_to_camera(tree, path, child, pose_source.camera_frame)
    return path, [f"ground truth: {len(path)} transforms from {parent!r} to {child!r} of {topic.name}", *notes]


def _path_from_poses(recording: Recording, topic: Topic, pose_source: PoseSource) -> tuple[Trajectory, list[str]]:
    edge, child = Edge("", is_static=False), frame_name(pose_source.child_frame or "")
    parents: set[str] = set()
    for time_ns, message in recording.messages(topic):
        edge.times_ns.append(stamp_ns(message.header) or time_ns)
        edge.numbers.extend(_pose(message, topic.kind))
        parents.add(frame_name(message.header.frame_id))
        child = child or frame_name(getattr(message, "child_frame_id", ""))
    if len(parents) > 1:
        raise DatasetError(f"{recording.path}: {topic.name} has poses in several frames: {sorted(parents)}; {_REMEDY}")
    path, notes = _move_to_camera(
        FrameTree(recording, None), edge.trajectory(topic.name), child, pose_source.camera_frame
    )
    summary = f"ground truth: {len(path)} poses of {topic.name} ({topic.type}); if they are an estimate, {_REMEDY}"
    return path, [summary, *notes]


def _path_from_fixes(recording: Recording, topic: Topic) -> tuple[Trajectory, list[str]]:
    """Positions of a satellite receiver, taken for the camera's. Raises DatasetError if it has no fix."""
    times_ns, fixes = array("q"), array("d")
    for time_ns, message in recording.messages(topic):
        place = (message.latitude, message.longitude, message.altitude)
        if getattr(getattr(message, "status", None), "status", 0) >= 0 and np.isfinite(place).all():
            times_ns.append(stamp_ns(message.header) or time_ns)
            fixes.extend(place)
    if not times_ns:
        raise DatasetError(f"{recording.path}: {topic.name} has no fix among {len(topic)} messages; {_REMEDY}")
    unique_ns, first = np.unique(np.frombuffer(times_ns, np.int64), return_index=True)
    poses = np.full((len(first), 4, 4), np.nan)
    poses[:, 3] = 0.0, 0.0, 0.0, 1.0
    poses[:, :3, 3] = positions_from_fixes(np.frombuffer(fixes, np.float64).reshape(-1, 3))[first]
    summary = f"ground truth: {len(first)} positions of {topic.name} ({topic.type}), without rotations"
    return Trajectory(unique_ns / 1e9, poses), [f"{summary}; its error, often meters, is part of every ATE"]


def positions_from_fixes(fixes: Floats) -> Floats:
    """Meters (N, 3) east, north and up of the first of fixes (N, 3): degrees of latitude and longitude, and altitude.

    By way of geocentric coordinates on the WGS 84 ellipsoid (NIMA TR8350.2).
    """
    latitude, longitude = np.radians(fixes[:, 0]), np.radians(fixes[:, 1])
    radius = _EQUATOR_M / np.sqrt(1.0 - _ECCENTRICITY_2 * np.sin(latitude) ** 2)
    across = (radius + fixes[:, 2]) * np.cos(latitude)
    along = ((1.0 - _ECCENTRICITY_2) * radius + fixes[:, 2]) * np.sin(latitude)
    centric = np.column_stack([across * np.cos(longitude), across * np.sin(longitude), along])
    turned = scipy.spatial.transform.Rotation.from_euler("ZY", [longitude[0], -latitude[0]]).inv()
    up_east_north = turned.apply(centric - centric[0])
    return np.asarray(up_east_north[:, [1, 2, 0]])


def _pose(message: Any, type_: str) -> tuple[float, ...]:
    if type_ == TRANSFORM:
        return pose_numbers(message.transform.translation, message.transform.rotation)
    pose = message.pose if type_ == POSE else message.pose.pose
    return pose_numbers(pose.position, pose.orientation)


def _move_to_camera(tree: FrameTree, path: Trajectory, child: str, camera_frame: str) -> tuple[Trajectory, list[str]]:
    """Move the path of frame `child` to the camera by static transforms; also return notes."""
    camera_frame = frame_name(camera_frame)
    if child == camera_frame and child:
        return path, []
    mounting = tree.static_between(child, camera_frame) if child and camera_frame else None
    if mounting is None:
        whose = f"those of {child!r}" if child else "those of an unnamed frame"
        return path, [
            f"the poses are {whose}, and no static transform leads to {camera_frame!r}: they are used as the camera's"
        ]
    camera_path = Trajectory(path.timestamps_s, path.world_from_camera @ mounting)
    return camera_path, [f"moved from {child!r} to {camera_frame!r} by static transforms"]
