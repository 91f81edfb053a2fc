"""Sequences whose frames are image files: reading them, and the digest of everything that they consist of."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any
from warnings import catch_warnings

import cv2
import numpy as np
from PIL import Image as PillowImage

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Image, channel_count
from codecbench.core.contracts.sequence import Camera, Frame, FrameSequence, Origin, Trajectory
from codecbench.plugins.codecs.jfif.quality import quality_from_jpeg
from codecbench.plugins.datasets.selection import Color, convert_color, workaround

EXTENSIONS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")
_JPEG_START, _JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"


def read_image_file(file: Path) -> Image:
    """The gray (H, W) or RGB (H, W, 3) picture in a file of 8 bits a sample; an alpha channel is left out.

    EXIF orientation is not applied. Raises DatasetError for a file that is missing, cut short or of another kind.
    """
    try:
        content = file.read_bytes()
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read: {error.strerror}") from error
    if content.startswith(_JPEG_START) and _JPEG_END not in content[-4096:]:
        raise DatasetError(f"{file}: the JPEG file is cut short; fetch or copy it again")
    try:
        stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error:
        stored = None
    if stored is None:
        raise DatasetError(f"{file}: not an image that OpenCV can read ({len(content)} bytes); fetch or copy it again")
    if stored.dtype != np.uint8:
        raise DatasetError(f"{file}: has samples of {stored.dtype}; frames have 8 bits a sample: convert the file")
    return _rgb_from_stored(stored)


def frame_size(file: Path, number: int) -> tuple[int, int]:
    """Width and height in pixels of frame `number` of a recording. Raises DatasetError as `read_image_file`."""
    with workaround(skip=[number]):
        height, width = read_image_file(file).shape[:2]
    return width, height


def _header_size(file: Path) -> tuple[int, int] | None:
    """Width and height as a file says without being decoded; None where that is not understood."""
    try:
        with catch_warnings(action="ignore"), PillowImage.open(file) as picture:
            return picture.size
    except (OSError, ValueError, SyntaxError, PillowImage.DecompressionBombError):
        return None


def _rgb_from_stored(stored: Any) -> Image:
    if stored.ndim == 2 or stored.shape[2] == 1:
        return np.asarray(stored.reshape(stored.shape[:2]), dtype=np.uint8)
    order = cv2.COLOR_BGRA2RGB if stored.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(stored, order), dtype=np.uint8)


def json_digest(value: Any) -> str:
    """Hex digest of a value of JSON types."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def file_digest(file: Path) -> str:
    """Hex digest of a file's bytes, remembered while its size and time of change stay. Raises DatasetError."""
    try:
        status = file.stat()
        return _version_digest(file, status.st_size, status.st_mtime_ns)
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read: {error.strerror}") from error


@cache
def _version_digest(file: Path, size_bytes: int, mtime_ns: int) -> str:
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@dataclass(frozen=True)
class Content:
    """What a sequence of image files consists of, after selection.

    numbers: of the files in the recording, as `skip` counts them; empty where its dataset has no `skip`. sizes_differ:
    whether frames of several sizes are allowed. where: what to call the sequence in errors. uncalibrated: parameters
    that open it without a camera which does not fit. origin: but for the sizes, which the sequence finds.
    """

    name: str
    where: str
    files: tuple[Path, ...]
    timestamps_s: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
    frame_rate_hz: float
    numbers: Sequence[int] = ()
    camera: Camera | None = None
    uncalibrated: dict[str, Any] = field(default_factory=dict)
    ground_truth: Trajectory | None = None
    color: Color = "as_is"
    sizes_differ: bool = False
    notes: tuple[str, ...] = ()
    origin: Origin = field(default_factory=Origin)


class FileSequence(FrameSequence):
    """Frames read from one image file each. Opening reads the first, and checks that all are there."""

    def __init__(self, content: Content) -> None:
        self.name = content.name
        self.timestamps_s = content.timestamps_s
        self.frame_rate_hz = content.frame_rate_hz
        self.camera = content.camera
        self.ground_truth = content.ground_truth
        self._content = content
        _check_files_exist(content)
        first = self._image(0)
        self.channels = channel_count(first)
        self._size = first.shape[:2]
        self.notes = (*content.notes, *jpeg_notes(content.files[0].read_bytes()))
        with workaround(**content.uncalibrated):
            self._check(first, content.files[0])

    @cached_property
    def fingerprint(self) -> str:  # type: ignore[override]
        """Digest over the bytes of all frames, times, camera and ground truth; the first use reads every file."""
        return json_digest(
            {
                "frames": [file_digest(file) for file in self._content.files],
                "channels": self.channels,
                **fingerprint_facts(self),
            }
        )

    @cached_property
    def origin(self) -> Origin:  # type: ignore[override]
        """What it was opened from; where sizes may differ, the first use reads the head of every file."""
        found = self._content.origin
        if not self._content.sizes_differ:
            return found
        sizes = sorted({size for file in self._content.files if (size := _header_size(file)) is not None})
        return replace(found, sizes=tuple(sizes)) if len(sizes) > 1 else found

    def read(self, index: int) -> Frame:
        if not 0 <= index < len(self):
            raise DatasetError(f"{self._content.where}: frame {index} is not in 0..{len(self) - 1}")
        image = self._image(index)
        with workaround(**_skip_params(self._content, [index])):
            self._check(image, self._content.files[index])
        return Frame(index, float(self.timestamps_s[index]), image)

    def _image(self, index: int) -> Image:
        with workaround(**_skip_params(self._content, [index])):
            return convert_color(read_image_file(self._content.files[index]), self._content.color)

    def _check(self, image: Image, file: Path) -> None:
        height, width = image.shape[:2]
        if channel_count(image) != self.channels:
            raise DatasetError(
                f"{file}: has {channel_count(image)} channel(s), the first frame {self.channels}; "
                "choose `color: rgb` or `color: gray`"
            )
        if (height, width) != self._size and not self._content.sizes_differ:
            raise DatasetError(f"{file}: is {width}x{height}, the first frame {self._size[1]}x{self._size[0]}")
        if self.camera is not None and (width, height) != (self.camera.width, self.camera.height):
            size = f"{self.camera.width}x{self.camera.height}"
            raise DatasetError(f"{file}: is {width}x{height}, but the calibration is for {size}; scale one of them")


def fingerprint_facts(sequence: FrameSequence) -> dict[str, Any]:
    """Times, camera and ground truth of a sequence as JSON types, for its fingerprint."""
    truth = sequence.ground_truth
    return {
        "timestamps_s": sequence.timestamps_s.tolist(),
        "frame_rate_hz": sequence.frame_rate_hz,
        "camera": None if sequence.camera is None else _camera_facts(sequence.camera),
        "ground_truth": None
        if truth is None
        else [hashlib.sha256(part.tobytes()).hexdigest() for part in (truth.timestamps_s, truth.world_from_camera)],
    }


def _camera_facts(camera: Camera) -> dict[str, Any]:
    facts = asdict(camera)
    return facts if camera.model != "pinhole" else {name: facts[name] for name in facts if name != "model"}


def _check_files_exist(content: Content) -> None:
    files = content.files
    missing = [index for index, file in enumerate(files) if not file.is_file()]
    if missing:
        more = f" (and {len(missing) - 1} more of {len(files)})" if len(missing) > 1 else ""
        said = f"{files[missing[0]]}: frame is missing{more}; fetch or copy the sequence again"
        raise DatasetError(said, _skip_params(content, missing) if 2 * len(missing) <= len(files) else {})


def _skip_params(content: Content, indices: Sequence[int]) -> dict[str, Any]:
    """The parameters that leave out these frames of the sequence, none where its dataset has no `skip`."""
    return {"skip": [content.numbers[index] for index in indices]} if len(content.numbers) else {}


def jpeg_notes(content: bytes) -> tuple[str, ...]:
    """What is to be said of pictures like the one in this file: nothing where it is no JPEG file."""
    if not content.startswith(_JPEG_START):
        return ()
    coded = quality_from_jpeg(content) or "JPEG"
    return (f"its frames are decoded {coded}: raw is what that left of them, and JPEG is at an advantage",)
