"""The dataset `video`: any file that OpenCV opens."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

import cv2
import numpy as np
from pydantic import Field

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import PathParam
from codecbench.core.contracts.sequence import Dataset, Frame, FrameSequence, Origin
from codecbench.plugins.datasets.files import EXTENSIONS, file_digest, fingerprint_facts, json_digest
from codecbench.plugins.datasets.selection import GivenCameraParams, Selection, convert_color, workaround

_SKIP_AT_MOST = 64
"""Frames ahead that are decoded and dropped before a jump is tried."""

_SAME_TIME_S = 1e-4
_USUAL_RATE_HZ = 30.0
_LOSSLESS = ("FFV1", "HFYU", "FFVH", "PNG", "MPNG", "I420", "IYUV", "RGBA", "BGR24", "RAW")
_GRAY_FORMATS = (b"Y800", b"Y1\0\x0a", b"Y1\0\x0c", b"Y1\0\x10")
"""FFmpeg's codes of gray pixel formats with 8, 10, 12 and 16 bits."""
_PICTURE_BRANDS = (b"heic", b"heix", b"mif1", b"avif")
"""Brands of still image formats whose files begin like MP4."""
_SAMPLED_FRAMES = 9
_BOX_HEAD_BYTES = 8
_LEAST_LOSS_S = 1.0
"""A file is damaged if it ends earlier than its stated length by more than this plus 2 %; containers round."""


class VideoParams(Selection, GivenCameraParams):
    """Set the frame rate and the camera of a video file."""

    path: Annotated[PathParam, Field(description="video file")]
    frame_rate_hz: Annotated[
        float | None, Field(gt=0.0, description="frames per second, instead of the file's own times")
    ] = None


class Video(Dataset[VideoParams]):
    """The frames of a video file: one channel if it is stored gray, else three; no ground truth."""

    name: ClassVar[str] = "video"
    version: ClassVar[str] = "1"
    params_type = VideoParams
    catch_all = True

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        """Recognize a file that OpenCV opens or that begins as MP4, except still images, which OpenCV opens too."""
        if path.suffix.lower() in EXTENSIONS or not path.is_file():
            return None
        known = _begins_as_mp4(path) or cv2.VideoCapture(str(path)).isOpened()
        return {"path": str(path)} if known else None

    def open(self) -> FrameSequence:
        return self.params.as_asked(VideoSequence(self.params))


@dataclass(frozen=True)
class _Index:
    """What one pass over a file finds."""

    times_s: tuple[float, ...]
    """Presentation times."""
    rate_hz: float
    """Nominal frame rate."""
    width: int
    height: int
    coding: str
    """Name of the codec."""
    is_gray: bool
    """Whether the file is stored without color."""
    truncation: str
    """A note on an end that cannot be decoded; empty if there is none."""

    @cached_property
    def has_times(self) -> bool:
        """Whether the times increase from frame to frame; raw streams have no times."""
        return all(before < now for before, now in zip(self.times_s, self.times_s[1:], strict=False))


class VideoSequence(FrameSequence):
    """Decodes forward; seeks a frame that is behind or far ahead, and checks the seek by the frame's time."""

    def __init__(self, params: VideoParams) -> None:
        self._params = params
        self._file = params.path
        index = index_video(self._file)
        if index.truncation and params.stop is None:
            raise DatasetError(f"{self._file}: {index.truncation}", {"stop": len(index.times_s)})
        chosen = params.indices(len(index.times_s), str(self._file))
        self._indices = chosen
        self._index = index
        if not index.has_times and params.frame_rate_hz is None:
            raise DatasetError(f"{self._file}: its frames have no increasing times; give `frame_rate_hz`")
        self.name = self._file.stem
        rate_hz = params.frame_rate_hz or index.rate_hz
        times_s = np.arange(len(index.times_s)) / rate_hz if params.frame_rate_hz else np.array(index.times_s)
        self.timestamps_s = times_s[np.array(chosen)]
        self.frame_rate_hz = rate_hz / params.stride
        self._color = "gray" if params.color == "as_is" and index.is_gray else params.color
        self.channels = 1 if self._color == "gray" else 3
        known = params.given_camera(lambda: (index.width, index.height))
        self.camera = known.camera
        self.ground_truth = None
        self.notes = (
            *params.subset_notes(len(index.times_s)),
            *known.notes,
            *([f"the file {index.truncation}"] if index.truncation else []),
        )
        coding = f"{index.coding} video".strip()
        self._origin = Origin(coding, known.source)
        if index.coding.upper() not in _LOSSLESS:
            self.notes += (f"its frames are decoded {coding}: raw includes its losses",)
        if self.camera is not None and (self.camera.width, self.camera.height) != (index.width, index.height):
            size = f"{self.camera.width}x{self.camera.height}"
            raise DatasetError(f"{self._file}: is {index.width}x{index.height}, but the calibration is for {size}")
        self._capture: cv2.VideoCapture | None = None
        self._next = 0

    @cached_property
    def origin(self) -> Origin:  # type: ignore[override]
        """Where the frames come from; the first access checks whether color frames show any color."""
        places = np.linspace(0, len(self) - 1, min(_SAMPLED_FRAMES, len(self))).astype(int).tolist()
        colored = self.channels == 1 or any(np.ptp(self.read(place).image, axis=2).any() for place in places)
        return self._origin if colored else replace(self._origin, params={"color": "gray"})

    @cached_property
    def fingerprint(self) -> str:  # type: ignore[override]
        """Digest over the file's bytes, the selection, times and camera."""
        contents = {"video": file_digest(self._file), "indices": list(self._indices), "channels": self.channels}
        return json_digest({**contents, **fingerprint_facts(self)})

    def read(self, index: int) -> Frame:
        if not 0 <= index < len(self):
            raise DatasetError(f"{self._file}: frame {index} is not in 0..{len(self) - 1}")
        source = self._indices[index]
        with workaround(skip=[source]):
            image = self._decode(source)
        return Frame(index, float(self.timestamps_s[index]), convert_color(image, self._color))

    def _decode(self, source: int) -> Image:
        capture = self._capture_at(source)
        self._next = source + 1
        done, stored = capture.read()
        if not done:
            self._capture = None
            raise DatasetError(f"{self._file}: frame {source} cannot be decoded; the file is damaged or has changed")
        if self._index.is_gray and stored.ndim == 3:
            return np.ascontiguousarray(stored[:, :, 0], dtype=np.uint8)
        code = cv2.COLOR_GRAY2RGB if stored.ndim == 2 else cv2.COLOR_BGR2RGB
        return np.asarray(cv2.cvtColor(stored, code), dtype=np.uint8)

    def _capture_at(self, source: int) -> cv2.VideoCapture:
        """The open file, positioned to decode frame `source` next."""
        capture = self._capture
        if capture is not None and not self._next <= source <= self._next + _SKIP_AT_MOST:
            capture = self._jump(capture, source)
        if capture is None:
            capture, self._next = _open_capture(self._file), 0
        for skipped in range(self._next, source):
            if not capture.grab():
                raise DatasetError(f"{self._file}: frame {skipped} cannot be decoded; the file has changed")
        self._capture = capture
        return capture

    def _jump(self, capture: cv2.VideoCapture, source: int) -> cv2.VideoCapture | None:
        """Seek to frame `source`, by way of the one before it; None if the seek does not land there."""
        if (
            source == 0
            or not self._index.has_times
            or not capture.set(cv2.CAP_PROP_POS_FRAMES, source - 1)
            or not capture.grab()
        ):
            return None
        if abs(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0 - self._index.times_s[source - 1]) > _SAME_TIME_S:
            return None
        self._next = source
        return capture


def index_video(file: Path) -> _Index:
    """Decode a file once for its frames' times; cached until the file changes. Raises DatasetError."""
    try:
        status = file.stat()
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read: {error.strerror}") from error
    return _index_version(file, status.st_size, status.st_mtime_ns)


@cache
def _index_version(file: Path, _size_bytes: int, _mtime_ns: int) -> _Index:
    """Index a file; size and modification time are only keys of the cache."""
    capture = _open_capture(file)
    rate_hz = capture.get(cv2.CAP_PROP_FPS)
    if not 0.0 < rate_hz < 1e5:
        rate_hz = _USUAL_RATE_HZ
    width, height = (int(capture.get(key)) for key in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
    code = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=True)
    coding = "".join(character for character in code.decode("latin-1") if character.isascii() and character.isalnum())
    is_gray = int(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)).to_bytes(4, "little", signed=True) in _GRAY_FORMATS
    declared_frames = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    times_s: list[float] = []
    while capture.grab():
        times_s.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0)
    capture.release()
    if not times_s:
        raise DatasetError(f"{file}: contains no frame that OpenCV can decode")
    index = _Index(tuple(times_s), rate_hz, width, height, coding, is_gray, "")
    length_s, declared_s = times_s[-1] - times_s[0], declared_frames / rate_hz
    if not index.has_times or length_s >= 0.98 * declared_s - _LEAST_LOSS_S:
        return index
    decodable = f"{length_s:.1f} s of {declared_s:.1f} s can be decoded, {len(times_s):,} frames"
    return replace(index, truncation=f"is cut short: {decodable}")


def _open_capture(file: Path) -> cv2.VideoCapture:
    capture = cv2.VideoCapture(str(file))
    if not capture.isOpened():
        if _begins_as_mp4(file) and not _has_index(file):
            raise DatasetError(
                f"{file}: is cut off: it has no index (`moov`), which MP4 and MOV files get last; "
                "`untrunc` may restore it with a complete file of the same camera; MKV recordings survive a cut"
            )
        raise DatasetError(f"{file}: not a video that OpenCV can open; convert it, or check that it is complete")
    return capture


def _begins_as_mp4(file: Path) -> bool:
    """Whether a file begins with an `ftyp` box that is not a still image's."""
    with suppress(OSError), open(file, "rb") as stream:
        head = stream.read(_BOX_HEAD_BYTES + 4)
        return head[4:8] == b"ftyp" and head[8:] not in _PICTURE_BRANDS
    return False


def _has_index(file: Path) -> bool:
    """Whether an MP4 or MOV file has a `moov` box. A box begins with its size in 4 bytes, then its name."""
    end = file.stat().st_size
    with open(file, "rb") as stream:
        start = 0
        while start + _BOX_HEAD_BYTES <= end:
            stream.seek(start)
            size, name = struct.unpack(">I4s", stream.read(_BOX_HEAD_BYTES))
            if size == 1:  # the size is in the next 8 bytes
                size = int.from_bytes(stream.read(8))
            if name == b"moov" and start + size <= end:
                return True
            if size < _BOX_HEAD_BYTES:  # 0: the box extends to the end of the file
                return False
            start += size
    return False
