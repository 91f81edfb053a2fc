"""The dataset `bag`: a topic of images in a ROS 1 bag, a ROS 2 bag or an MCAP file."""

from __future__ import annotations

import hashlib
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Image, layout_of
from codecbench.core.contracts.params import PathParam
from codecbench.core.contracts.sequence import Dataset, Depth, Frame, FrameSequence, Origin
from codecbench.plugins.datasets.bag.camera_topic import camera_from_topic, camera_topic
from codecbench.plugins.datasets.bag.coded_video import CodedVideo
from codecbench.plugins.datasets.bag.depth import decode_depth, depth_notes, is_depth
from codecbench.plugins.datasets.bag.ground_truth import PoseSource, find_ground_truth, frame_name
from codecbench.plugins.datasets.bag.images import (
    bits_of,
    compressed_notes,
    decode_compressed,
    decode_image,
    image_notes,
    is_supported,
    largest_sample,
)
from codecbench.plugins.datasets.bag.messages import CAMERA_INFO, COMPRESSED, IMAGE, VIDEO
from codecbench.plugins.datasets.bag.recording import Integers, Recording, Topic, has_bag_name, open_recording
from codecbench.plugins.datasets.calibration import describe_lens
from codecbench.plugins.datasets.files import fingerprint_facts, json_digest
from codecbench.plugins.datasets.selection import (
    DepthParams,
    GivenCameraParams,
    KnownCamera,
    Selection,
    convert_color,
    read_camera_file,
    workaround,
)
from codecbench.plugins.datasets.tables import rate_hz

_USUAL_RATE_HZ: Final = 30.0
_USUAL_UNIT_M: Final = 0.001
"""Step of 16UC1, from ROS's REP 118; 32FC1 is rounded to it."""
_MOST_LISTED: Final = 40
_SAMPLED_FRAMES: Final = 9


class BagParams(Selection, GivenCameraParams, DepthParams):
    """Set which topics of a bag give the frames, the camera and the ground truth."""

    path: Annotated[PathParam, Field(description="a .bag, .mcap or .db3 file, or the folder of a ROS 2 bag")]
    topic: Annotated[str | None, Field(description="image topic; default: the only one")] = None
    time: Annotated[
        Literal["header", "bag"], Field(description="frame times: of the message headers, or of the recording")
    ] = "header"
    samples: Annotated[
        Literal["auto", "8_bits", "16_bits", "depth"],
        Field(
            description="of more than 8 bits: auto takes depth (32FC1, compressedDepth, 16UC1 of a topic named so) as "
            "distances, and 8 bits of others"
        ),
    ] = "auto"
    bits: Annotated[
        int, Field(ge=8, le=16, description="bits in use of 16-bit samples; the upper 8 of them are kept")
    ] = 16
    camera: Annotated[
        str,
        Field(
            description="sensor_msgs/CameraInfo topic; auto: next to the image topic, or the only one; none: no camera"
        ),
    ] = "auto"
    ground_truth: Annotated[
        str, Field(description="topic of poses or transforms; auto: the only pose topic; none: do not use any")
    ] = "auto"
    parent_frame: Annotated[str | None, Field(description="fixed frame in /tf; default: the root")] = None
    child_frame: Annotated[
        str | None,
        Field(description="frame that the poses are of; default: from the messages, in /tf the frame of the images"),
    ] = None

    @model_validator(mode="after")
    def _camera_once(self) -> Self:
        self.check_one_camera_source(self.camera)
        return self


class Bag(Dataset[BagParams]):
    """Frames of one topic in the order of their times, with the recording's camera and poses."""

    name: ClassVar[str] = "bag"
    version: ClassVar[str] = "1"
    params_type = BagParams

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        """Recognize a file with a bag's suffix, or a folder that holds such files of ROS 2."""
        return {"path": str(path)} if has_bag_name(path) else None

    def open(self) -> FrameSequence:
        return self.params.as_asked(BagSequence(self.params))


class BagSequence(FrameSequence):
    """Reads one message per frame. Opening reads all messages of the images, the camera and the poses once."""

    def __init__(self, params: BagParams) -> None:
        self._params = params
        self._recording = open_recording(params.path)
        self._topic = image_topic(self._recording, params.topic)
        self._video = CodedVideo(self._recording, self._topic) if self._topic.kind == VIDEO else None
        first_number = None if self._video is None else self._video.first
        times_ns, numbers, order_notes = _sort_messages(self._recording, self._topic, params.time, first_number)
        self._chosen = params.indices(len(numbers), f"{params.path} {self._topic.name}")
        chosen = np.array(self._chosen)
        self._numbers = numbers[chosen]
        self.name = params.path.resolve().stem
        self.timestamps_s = times_ns[chosen] / 1e9
        self.frame_rate_hz = rate_hz((times_ns - times_ns[0]) / 1e9, _USUAL_RATE_HZ * params.stride) / params.stride
        with workaround(skip=[self._chosen[0]]):
            first = self._recording.message(self._topic, int(self._numbers[0]))
        if params.samples == "depth" or (params.samples == "auto" and is_depth(first, self._topic.name)):
            self.depth = params.meaning(Depth(_USUAL_UNIT_M))
        image = self._read_image(0)
        self.channels, self.bits = layout_of(image)
        self._size = image.shape[1::-1]
        uncalibrated = {} if params.calibration else {"camera": "none"}
        with workaround(**uncalibrated):
            known = params.or_ideal_camera(self._known_camera(), lambda: (image.shape[1], image.shape[0]))
        self.camera = known.camera
        frame = frame_name(first.header.frame_id)
        pose_source = PoseSource(params.ground_truth, params.parent_frame, params.child_frame, frame)
        with workaround(ground_truth="none"):
            self.ground_truth, truth_notes = find_ground_truth(self._recording, pose_source)
        largest = self._largest_sample() if self._topic.kind == IMAGE and self.bits == 8 else None
        suited: dict[str, Any] = {}
        if largest is not None and bits_of(largest) != params.bits:
            suited = {"bits": bits_of(largest)}
        elif self._video is not None and self.channels == 3 and not self._video.shows_color():
            suited = {"color": "gray"}
        format_notes = self._format_notes(first, largest, times_ns)
        self.origin = Origin(f"{self._recording.kind}, topic {self._topic.name}", known.source, params=suited)
        subset_notes = params.subset_notes(len(numbers))
        self.notes = (
            *self._recording.remarks,
            describe_topic(self._recording, self._topic, self._video),
            *subset_notes,
            *format_notes,
            *order_notes,
        )
        self.notes += (*known.notes, *truth_notes)
        with workaround(**uncalibrated):
            self._check(image, int(self._numbers[0]))

    @cached_property
    def fingerprint(self) -> str:  # type: ignore[override]
        """Digest over the messages of all frames, times, camera and ground truth; the first access reads them all."""
        numbers = self._numbers.tolist()
        if self._video is not None:  # frames depend on packets between
            numbers += range(self._video.key_before(min(numbers)), max(numbers) + 1)
        messages = (self._recording.raw(self._topic, number) for number in numbers)
        return json_digest(
            {
                "messages": [hashlib.sha256(message).hexdigest() for message in messages],
                "bits": self._params.bits,
                "channels": self.channels,
                **({} if self.bits == 8 else {"samples": self.bits}),
                **fingerprint_facts(self),
            }
        )

    def read(self, index: int) -> Frame:
        if not 0 <= index < len(self):
            raise DatasetError(f"{self._params.path}: frame {index} is not in 0..{len(self) - 1}")
        image = self._read_image(index)
        with workaround(skip=[self._chosen[index]]):
            self._check(image, int(self._numbers[index]))
        return Frame(index, float(self.timestamps_s[index]), image)

    def _read_image(self, index: int) -> Image:
        number = int(self._numbers[index])
        with workaround(skip=[self._chosen[index]]):
            image = self._decode(number) if self._video is None else self._video.image(number)
        return convert_color(image, self._params.color)

    def _decode(self, number: int) -> Image:
        message, where = self._recording.message(self._topic, number), self._recording.where(self._topic, number)
        if self.depth is not None:
            return decode_depth(message, self.depth, where)
        decode = decode_compressed if self._topic.kind == COMPRESSED else decode_image
        return decode(message, None if self._params.samples == "16_bits" else self._params.bits, where)

    def _format_notes(self, first: Any, largest: int | None, times_ns: Integers) -> list[str]:
        """Notes on how the frames were recorded. largest: see `image_notes`."""
        if self._video is not None:
            return self._video.notes(times_ns, self._size)
        if self.depth is not None:
            return depth_notes(first, self.depth)
        if self._topic.kind == COMPRESSED:
            return compressed_notes(first)
        return image_notes(first, self._params.bits, largest)

    def _largest_sample(self) -> int | None:
        """The largest sample of a few frames spread over the sequence; None if they do not have 16 bits."""
        samples: list[int] = []
        places = np.unique(np.linspace(0, len(self._numbers) - 1, _SAMPLED_FRAMES).astype(int))
        for number in self._numbers[places].tolist():
            with suppress(DatasetError):  # reading a damaged frame raises its error later
                largest = largest_sample(self._recording.message(self._topic, number))
                if largest is None:
                    return None
                samples.append(largest)
        return max(samples, default=None)

    def _known_camera(self) -> KnownCamera:
        """The camera from the calibration file or a topic. Raises DatasetError."""
        params = self._params
        if params.calibration is not None:
            return read_camera_file(params.calibration)[0]
        if params.camera == "none":
            return KnownCamera()
        if params.camera == "auto":
            topic = camera_topic(self._recording, self._topic)
        else:
            topic = _find_camera_topic(self._recording, params.camera)
        if topic is None:
            if params.fov_deg is not None:
                return KnownCamera()
            remedy = "set `calibration: FILE` or `fov_deg`"
            return KnownCamera(notes=(f"no camera: the image topic has no camera_info; {remedy}",))
        camera = camera_from_topic(self._recording, topic, self._topic)
        if camera is None:
            return KnownCamera(notes=(f"no camera: {topic.name} is not calibrated (its focal length is 0)",))
        summary = f"camera: {topic.name}, {camera.width}x{camera.height}, fx {camera.fx:.6g}, {describe_lens(camera)}"
        return KnownCamera(camera, "camera_info", (summary,))

    def _check(self, image: Image, number: int) -> None:
        where = self._recording.where(self._topic, number)
        (width, height), camera = image.shape[1::-1], self.camera
        if self.depth is not None and image.dtype != np.uint16:
            raise DatasetError(f"{where}: has samples of {image.dtype}; depth has 16 bits")
        if (width, height) != self._size or layout_of(image) != self.layout:
            first = f"{self._size[0]}x{self._size[1]}, {self.layout}"
            raise DatasetError(f"{where}: is {width}x{height}, {layout_of(image)}, the first frame {first}")
        if camera is not None and (width, height) != (camera.width, camera.height):
            raise DatasetError(
                f"{where}: is {width}x{height}, but the calibration is for {camera.width}x{camera.height}; "
                "give `calibration: FILE`, or `camera: none`"
            )


def image_topic(recording: Recording, name: str | None) -> Topic:
    """The topic called `name`, else the only topic of images. Raises DatasetError, which lists the topics."""
    images = {
        topic.name: topic
        for topic in recording.topics.values()
        if topic.kind in (IMAGE, COMPRESSED, VIDEO) and len(topic)
    }
    if name is not None and name in images:
        return images[name]
    readable = {name: topic for name, topic in images.items() if _may_be_intensities(recording, topic)}
    if name is None and len(readable or images) == 1:
        return next(iter((readable or images).values()))
    if not images:
        topics = list(recording.topics.values())[:_MOST_LISTED]
        listed = ", ".join(f"{topic.name} ({topic.type}, {len(topic)})" for topic in topics)
        raise DatasetError(f"{recording.path}: has no image topic; topics: {listed or 'none'}")
    listed = "".join(f"\n  {describe_topic(recording, topic)}" for topic in list(images.values())[:_MOST_LISTED])
    what = f"{len(images)} image topics" if name is None else f"topic {name!r} has no images"
    raise DatasetError(f"{recording.path}: {what}; choose one with `topic`:{listed}")


def _may_be_intensities(recording: Recording, topic: Topic) -> bool:
    """Whether a topic's first image is no depth and of a supported encoding; True if that message is damaged."""
    try:
        message = recording.message(topic, 0)
        return is_supported(message) and not is_depth(message, topic.name)
    except DatasetError:
        return True


def describe_topic(recording: Recording, topic: Topic, video: CodedVideo | None = None) -> str:
    """Describe a topic of images: its name, count, type and size. video: that of the topic, if it is open already."""
    try:
        message = recording.message(topic, 0)
        if topic.kind == VIDEO:
            video = video or CodedVideo(recording, topic)
            height, width = video.image(video.first).shape[:2]
            kind = video.coding
        elif topic.kind == COMPRESSED:
            where = recording.where(topic, 0)
            depth = is_depth(message, topic.name)
            image = (
                decode_depth(message, Depth(_USUAL_UNIT_M), where) if depth else decode_compressed(message, 16, where)
            )
            height, width = image.shape[:2]
            kind = message.format.strip()[:40]
        else:
            width, height, kind = message.width, message.height, message.encoding[:40]
        size = f"{width}x{height} {kind}"
    except DatasetError as error:
        size = f"unreadable ({error})"
    return f"{topic.name}: {len(topic)} of {topic.type}, {size}"


def _find_camera_topic(recording: Recording, name: str) -> Topic:
    """The CameraInfo topic called `name`. Raises DatasetError."""
    topic = recording.topics.get(name)
    if topic is None or topic.kind != CAMERA_INFO or not len(topic):
        names = [topic.name for topic in recording.topics.values() if topic.kind == CAMERA_INFO]
        raise DatasetError(f"{recording.path}: camera {name!r} is not a topic of {CAMERA_INFO}; set one of {names}")
    return topic


def _sort_messages(
    recording: Recording, topic: Topic, time: str, first: int | None
) -> tuple[Integers, Integers, list[str]]:
    """Strictly increasing times in ns, the numbers of their messages, and notes on both.

    first: number of the first message of video that can be decoded; earlier ones are left out.
    """
    (times_ns, headers_ns, damage), notes = recording.index(topic), []
    if damage is not None:
        notes.append(f"only {len(times_ns)} of {len(topic)} frames are read, up to the damage: {damage}")
    if time == "header":
        if headers_ns.min() <= 0:
            notes.append("times are those of the recording, because headers have none")
        else:
            times_ns = headers_ns
    numbers = np.arange(len(times_ns))
    if first is not None:
        numbers = np.flatnonzero((numbers >= first) & (times_ns >= times_ns[first]))
    if earlier := len(times_ns) - len(numbers):
        notes.append(f"frames begin at the first key frame, {topic.name}[{first}]: {earlier} before it are left out")
    times_ns = times_ns[numbers]
    unique_ns, places = np.unique(times_ns, return_index=True)
    if (repeated := len(times_ns) - len(unique_ns)) > 0:
        notes.append(f"{repeated} frames are left out because another has the same time")
    if (np.diff(times_ns) < 0).any():
        notes.append("frames are sorted by time, which changes the order of the recording")
    return unique_ns, numbers[places].astype(np.int64), notes
