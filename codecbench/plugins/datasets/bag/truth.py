"""The camera's true path from poses in a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Trajectory
from codecbench.plugins.datasets.bag.messages import ODOMETRY, POSE, POSE_COVARIANCE, TRANSFORM, TRANSFORMS
from codecbench.plugins.datasets.bag.recording import Recording, Topic
from codecbench.plugins.datasets.bag.transforms import Edge, FrameTree, frame_name, pose_numbers, stamp_ns

POSE_TYPES: Final = (POSE, POSE_COVARIANCE, TRANSFORM, ODOMETRY)
_REMEDY: Final = "`ground_truth: none` goes without"


@dataclass(frozen=True)
class PoseSource:
    """Where the truth is asked for: a topic, `auto` or `none`; between which frames; and the frame of the pictures."""

    topic: str
    parent_frame: str | None
    child_frame: str | None
    camera_frame: str


def true_path(recording: Recording, pose_source: PoseSource) -> tuple[Trajectory | None, list[str]]:
    """The camera's poses over time, or None, and what has to be said of them. Raises DatasetError."""
    if pose_source.topic == "none":
        return None, []
    if pose_source.topic == "auto":
        topic, notes = _only_topic(recording)
        if topic is None:
            return None, notes
    else:
        topic = _named(recording, pose_source.topic)
    if topic.type in TRANSFORMS:
        return _from_transforms(recording, topic, pose_source)
    return _from_poses(recording, topic, pose_source)


def _only_topic(recording: Recording) -> tuple[Topic | None, list[str]]:
    poses = [topic for topic in recording.topics.values() if topic.type in POSE_TYPES and len(topic)]
    if len(poses) == 1:
        return poses[0], []
    names = ", ".join(topic.name for topic in poses or _moving(recording))
    if not names:
        return None, []
    return None, [f"no ground truth was taken; `ground_truth: TOPIC` takes that of a topic of poses: {names}"]


def _moving(recording: Recording) -> list[Topic]:
    return [
        topic
        for topic in recording.topics.values()
        if topic.type in TRANSFORMS and not topic.name.endswith("tf_static")
    ]


def _named(recording: Recording, name: str) -> Topic:
    topic = recording.topics.get(name)
    if topic is None or not len(topic) or topic.type not in (*POSE_TYPES, *TRANSFORMS):
        found = [topic.name for topic in recording.topics.values() if topic.type in (*POSE_TYPES, *TRANSFORMS)]
        what = "is not there" if topic is None else f"holds {len(topic)} messages of {topic.type}"
        raise DatasetError(
            f"{recording.path}: ground_truth {name!r} {what}; topics of poses: {', '.join(found) or 'none'}; {_REMEDY}"
        )
    return topic


def _from_transforms(recording: Recording, topic: Topic, pose_source: PoseSource) -> tuple[Trajectory, list[str]]:
    child = frame_name(pose_source.child_frame or pose_source.camera_frame)
    tree = FrameTree(recording, topic)
    parent, path = tree.path(frame_name(pose_source.parent_frame) if pose_source.parent_frame else None, child)
    path, notes = _of_camera(tree, path, child, pose_source.camera_frame)
    return path, [f"ground truth: {len(path)} transforms from {parent!r} to {child!r} of {topic.name}", *notes]


def _from_poses(recording: Recording, topic: Topic, pose_source: PoseSource) -> tuple[Trajectory, list[str]]:
    edge, child = Edge("", is_static=False), frame_name(pose_source.child_frame or "")
    parents: set[str] = set()
    for time_ns, message in recording.messages(topic):
        edge.times_ns.append(stamp_ns(message.header) or time_ns)
        edge.numbers.extend(_pose(message, topic.type))
        parents.add(frame_name(message.header.frame_id))
        child = child or frame_name(getattr(message, "child_frame_id", ""))
    if len(parents) > 1:
        raise DatasetError(f"{recording.path}: {topic.name} has poses in several frames: {sorted(parents)}; {_REMEDY}")
    path, notes = _of_camera(FrameTree(recording, None), edge.trajectory(topic.name), child, pose_source.camera_frame)
    said = f"ground truth: {len(path)} poses of {topic.name} ({topic.type}); if they are an estimate, {_REMEDY}"
    return path, [said, *notes]


def _pose(message: Any, type_: str) -> tuple[float, ...]:
    if type_ == TRANSFORM:
        return pose_numbers(message.transform.translation, message.transform.rotation)
    pose = message.pose if type_ == POSE else message.pose.pose
    return pose_numbers(pose.position, pose.orientation)


def _of_camera(tree: FrameTree, path: Trajectory, child: str, camera_frame: str) -> tuple[Trajectory, list[str]]:
    """The path of the camera from that of a frame which it is fixed to by static transforms."""
    camera_frame = frame_name(camera_frame)
    if child == camera_frame and child:
        return path, []
    mounting = tree.static_between(child, camera_frame) if child and camera_frame else None
    if mounting is None:
        whose = f"those of {child!r}" if child else "of a frame that is not named"
        return path, [
            f"the poses are {whose}, and no static transform leads to {camera_frame!r}: taken as the camera's"
        ]
    moved = Trajectory(path.timestamps_s, path.world_from_camera @ mounting)
    return moved, [f"moved from {child!r} to {camera_frame!r} by static transforms"]
