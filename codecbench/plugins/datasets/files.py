"""Sequences of image files: reading frames, checking them, and the sequence's fingerprint."""

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
from codecbench.core.contracts.image import Image, channel_count, layout_of
from codecbench.core.contracts.sequence import Camera, Depth, Frame, FrameSequence, Origin, Trajectory
from codecbench.plugins.codecs.jfif import quality_from_jpeg
from codecbench.plugins.datasets.selection import Color, convert_color, workaround

EXTENSIONS = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm")
_JPEG_START, _JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"


def read_image_file(file: Path) -> Image:
    """Read a gray (H, W) image of 8 or 16 bits, or an RGB (H, W, 3) image of 8; an alpha channel is dropped.

    EXIF orientation is not applied. Raises DatasetError if the file is missing, truncated or of another kind.
    """
    try:
        content = file.read_bytes()
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read: {error.strerror}") from error
    return decode_image_file(content, str(file))


def decode_image_file(content: bytes, file: str) -> Image:
    """Decode the content of an image file as `read_image_file` does. Raises DatasetError, naming `file`."""
    if content.startswith(_JPEG_START) and _JPEG_END not in content[-4096:]:
        raise DatasetError(f"{file}: the JPEG file is cut short; fetch or copy it again")
    try:
        stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error:
        stored = None
    if stored is None:
        raise DatasetError(f"{file}: not an image that OpenCV can read ({len(content)} bytes); fetch or copy it again")
    if stored.dtype == np.uint16 and stored.ndim == 2:
        return np.asarray(stored, dtype=np.uint16)
    if stored.dtype != np.uint8:
        layout = f"{1 if stored.ndim == 2 else stored.shape[2]} channel(s) of {stored.dtype}"
        raise DatasetError(f"{file}: has {layout}; frames have 8 bits, or 16 and are gray: convert the file")
    return _rgb_from_stored(stored)


def frame_size(file: Path, number: int) -> tuple[int, int]:
    """Width and height in pixels of frame `number` of a recording. Raises DatasetError, see `read_image_file`."""
    with workaround(skip=[number]):
        height, width = read_image_file(file).shape[:2]
    return width, height


def image_header(file: Path) -> tuple[tuple[int, int], str]:
    """Width and height, and Pillow's mode, without decoding the file; (0, 0) if its header cannot be read."""
    try:
        with catch_warnings(action="ignore"), PillowImage.open(file) as header_image:
            return header_image.size, header_image.mode
    except (OSError, ValueError, SyntaxError, PillowImage.DecompressionBombError):
        return (0, 0), ""


def _rgb_from_stored(stored: Any) -> Image:
    if stored.ndim == 2 or stored.shape[2] == 1:
        return np.asarray(stored.reshape(stored.shape[:2]), dtype=np.uint8)
    order = cv2.COLOR_BGRA2RGB if stored.shape[2] == 4 else cv2.COLOR_BGR2RGB
    return np.asarray(cv2.cvtColor(stored, order), dtype=np.uint8)


def json_digest(value: Any) -> str:
    """Hex SHA-256 of a value of JSON types."""
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def file_digest(file: Path) -> str:
    """Hex SHA-256 of a file's bytes, cached until its size or modification time changes. Raises DatasetError."""
    try:
        status = file.stat()
        return _version_digest(file, status.st_size, status.st_mtime_ns)
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read: {error.strerror}") from error


@cache
def _version_digest(file: Path, _size_bytes: int, _mtime_ns: int) -> str:
    """Hex SHA-256 of a file; size and modification time are only keys of the cache."""
    with open(file, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@dataclass(frozen=True)
class Content:
    """What a sequence of image files consists of, after selection."""

    name: str
    where: str
    """Name of the sequence in errors."""
    files: tuple[Path, ...]
    timestamps_s: np.ndarray[tuple[int, ...], np.dtype[np.float64]]
    frame_rate_hz: float
    numbers: Sequence[int] = ()
    """Index of each file in the recording, as `skip` counts them; empty if the dataset has no `skip`."""
    camera: Camera | None = None
    uncalibrated: dict[str, Any] = field(default_factory=dict)
    """Parameters that open the sequence without its camera, suggested if the calibration does not fit."""
    depth: Depth | None = None
    """What pixels mean if they are distances."""
    ground_truth: Trajectory | None = None
    color: Color = "as_is"
    sizes_differ: bool = False
    """Whether frames of several sizes are allowed."""
    notes: tuple[str, ...] = ()
    origin: Origin = field(default_factory=Origin)
    """Without `sizes`, which the sequence adds."""


class FileSequence(FrameSequence):
    """Reads each frame from an image file. Opening reads the first and checks that all files exist."""

    def __init__(self, content: Content) -> None:
        self.name = content.name
        self.timestamps_s = content.timestamps_s
        self.frame_rate_hz = content.frame_rate_hz
        self.camera = content.camera
        self.ground_truth = content.ground_truth
        self.depth = content.depth
        self._content = content
        _check_files_exist(content)
        first = self._image(0)
        self.channels, self.bits = layout_of(first)
        self._size = first.shape[:2]
        self.notes = (*content.notes, *jpeg_notes(content.files[0].read_bytes()))
        with workaround(**content.uncalibrated):
            self._check(first, content.files[0])

    @cached_property
    def fingerprint(self) -> str:  # type: ignore[override]
        """Digest over the bytes of all frames, times, camera and ground truth; the first access reads every file."""
        return json_digest(
            {
                "frames": [file_digest(file) for file in self._content.files],
                "channels": self.channels,
                **({} if self.bits == 8 else {"bits": self.bits}),
                **fingerprint_facts(self),
            }
        )

    @cached_property
    def origin(self) -> Origin:  # type: ignore[override]
        """Where the frames come from; if sizes may differ, the first access reads the header of every file."""
        origin = self._content.origin
        if not self._content.sizes_differ:
            return origin
        sizes = sorted({image_header(file)[0] for file in self._content.files} - {(0, 0)})
        return replace(origin, sizes=tuple(sizes)) if len(sizes) > 1 else origin

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
        if self.depth is not None and image.dtype != np.uint16:
            raise DatasetError(f"{file}: has samples of {image.dtype}; depth has 16 bits")
        if layout_of(image).bits != self.bits:
            raise DatasetError(f"{file}: has {layout_of(image).bits} bits, the first frame {self.bits}")
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
        **({} if sequence.depth is None else {"depth": asdict(sequence.depth)}),
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
        message = f"{files[missing[0]]}: frame is missing{more}; fetch or copy the sequence again"
        raise DatasetError(message, _skip_params(content, missing) if 2 * len(missing) <= len(files) else {})


def _skip_params(content: Content, indices: Sequence[int]) -> dict[str, Any]:
    """The parameters that skip these frames of the sequence; empty if its dataset has no `skip`."""
    return {"skip": [content.numbers[index] for index in indices]} if len(content.numbers) else {}


def jpeg_notes(content: bytes) -> tuple[str, ...]:
    """Notes on a sequence whose first file has this content: one that its frames were JPEG files, or none."""
    if not content.startswith(_JPEG_START):
        return ()
    coding = quality_from_jpeg(content) or "JPEG"
    return (f"its frames are decoded {coding}: raw includes its losses, and JPEG has an advantage",)
