"""The dataset `lerobot`: one camera of an episode in a LeRobot dataset on disk, format 2.0, 2.1 or 3.0.

Format: huggingface/lerobot, `docs/source/lerobot-dataset-v3.mdx`, and its readers before and after version 0.4.
"""

from __future__ import annotations

import hashlib
import math
import os
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal, NamedTuple

import numpy as np
from pydantic import AliasChoices, BaseModel, Field, ValidationError

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import MAX_PIXELS, Image, layout_of
from codecbench.core.contracts.params import PathParam
from codecbench.core.contracts.sequence import Dataset, Frame, FrameSequence, Origin
from codecbench.plugins.codecs.video.library import decoding_errors, load_av, samples_of_frame
from codecbench.plugins.datasets.files import decode_image_file, fingerprint_facts, jpeg_notes, json_digest
from codecbench.plugins.datasets.selection import GivenCameraParams, Selection, already_coded, convert_color, workaround

_TOLERANCE: Final = 0.25
"""Distance of a row from its frame at most, in frame intervals."""
_FETCH: Final = "fetch or copy the dataset again"


class LerobotParams(Selection, GivenCameraParams):
    """Set the camera and the episode of a LeRobot dataset."""

    path: Annotated[PathParam, Field(description="the dataset's folder, which contains meta/info.json")]
    camera: Annotated[
        str | None,
        Field(description="video or image feature, such as observation.images.top or top; default: the only one"),
    ] = None
    episode: Annotated[int, Field(ge=0, description="number of the episode, from 0")] = 0


class Lerobot(Dataset[LerobotParams]):
    """The frames of one camera in one episode, as LeRobot decodes them; no ground truth.

    Times are the Parquet column `timestamp`, seconds from the start of the episode, by which LeRobot finds frames. A
    video's own times go on over the episodes of a 3.0 file, and are rounded to its time base.
    """

    name: ClassVar[str] = "lerobot"
    version: ClassVar[str] = "1"
    params_type = LerobotParams

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        """Recognize a folder that contains `meta/info.json`, or its `meta`."""
        folder = path.parent if path.name == "meta" else path
        return {"path": str(folder)} if (folder / "meta" / "info.json").is_file() else None

    def open(self) -> FrameSequence:
        return self.params.as_asked(LerobotSequence(self.params))


class _Feature(BaseModel):
    dtype: str
    shape: list[int] = []
    names: list[Any] | dict[str, Any] | None = None
    info: dict[str, Any] | None = Field(default=None, validation_alias=AliasChoices("info", "video_info"))


class _Info(BaseModel):
    """What is used of `meta/info.json`."""

    codebase_version: Literal["v2.0", "v2.1", "v3.0"]
    fps: float = Field(gt=0.0, le=1e5)
    features: dict[str, _Feature]
    data_path: str
    video_path: str | None = None
    total_episodes: int
    chunks_size: int = Field(default=1000, gt=0)
    robot_type: str | None = None


class _Episode(NamedTuple):
    """Where the rows and the frames of an episode are, which takes start_s <= time < stop_s of its video."""

    rows: Path
    video: Path
    start_s: float
    stop_s: float
    tasks: str


class LerobotSequence(FrameSequence):
    """Reads frames from the video of an episode, or for a feature of dtype `image` from its rows."""

    def __init__(self, params: LerobotParams) -> None:
        self._params, info = params, _read_info(params.path)
        camera = _choose_camera(params.path, info.features, params.camera)
        is_video = info.features[camera].dtype == "video"
        episode = _find_episode(params.path, info, camera if is_video else None, params.episode)
        self._where = f"{params.path}: {camera}, episode {params.episode}"
        times_s, contents = _read_rows(episode.rows, params.episode, None if is_video else camera)
        self._frames = _Video(episode, times_s, info.fps) if is_video else _Pictures(episode.rows, contents)
        count, damage = len(self._frames), self._frames.damage
        if damage and params.stop is None:
            raise DatasetError(damage[0], {"stop": count} if count else {})
        self._chosen = params.indices(count, self._where)
        self.name = f"{params.path.resolve().name}-{camera.rpartition('.')[2]}-{params.episode}"
        self.timestamps_s, self.frame_rate_hz = times_s[np.array(self._chosen)], info.fps / params.stride
        self._shape: tuple[int, ...] = ()
        first = self._image(0)
        self._shape, (self.channels, self.bits) = first.shape, layout_of(first)
        known = params.given_camera(lambda: (first.shape[1], first.shape[0]))
        self.camera, self.ground_truth = known.camera, None
        if self.camera is not None and (self.camera.height, self.camera.width) != first.shape[:2]:
            size, given = f"{first.shape[1]}x{first.shape[0]}", f"{self.camera.width}x{self.camera.height}"
            raise DatasetError(f"{self._where}: is {size}, but the calibration is for {given}")
        robot = f"{info.robot_type}, " if info.robot_type else ""
        about = (
            f"{robot}{info.fps:g} Hz, episode {params.episode} of {info.total_episodes:,}: {episode.tasks or 'no task'}"
        )
        self.notes = (about, *damage, *params.subset_notes(count), *known.notes, *self._frames.coding)
        kind = f"LeRobot dataset {info.codebase_version}, {camera}, episode {params.episode}"
        self.origin = Origin(kind, known.source)

    @cached_property
    def fingerprint(self) -> str:  # type: ignore[override]
        """Digest over the coded frames of the episode, the selection, times and camera."""
        contents = {"frames": self._frames.digest, "indices": list(self._chosen), "channels": self.channels}
        return json_digest({**contents, **fingerprint_facts(self)})

    def read(self, index: int) -> Frame:
        if not 0 <= index < len(self):
            raise DatasetError(f"{self._where}: frame {index} is not in 0..{len(self) - 1}")
        return Frame(index, float(self.timestamps_s[index]), self._image(index))

    def _image(self, index: int) -> Image:
        with workaround(skip=[self._chosen[index]]):
            image = convert_color(self._frames.read(self._chosen[index]), self._params.color)
            if self._shape and image.shape != self._shape:
                where = f"{self._where}: frame {self._chosen[index]}"
                raise DatasetError(f"{where} has the shape {image.shape}, the first frame {self._shape}")
            return image


class _Pictures:
    """Image files from the rows of an episode."""

    damage: tuple[str, ...] = ()

    def __init__(self, file: Path, contents: list[bytes]) -> None:
        self._file, self._contents, self.coding = file, contents, jpeg_notes(contents[0])
        self.digest = json_digest([hashlib.sha256(content).hexdigest() for content in contents])

    def __len__(self) -> int:
        return len(self._contents)

    def read(self, row: int) -> Image:
        return decode_image_file(self._contents[row], f"{self._file}: the picture in row {row} of the episode")


class _Video:
    """Decodes an episode with PyAV. Opening seeks to it in a file of several, and reads packets without decoding."""

    def __init__(self, episode: _Episode, times_s: Any, fps: float) -> None:
        self._file, self._process, self._rank = episode.video, -1, -1
        with _video_errors(self._file), _open_video(self._file) as container:
            self._demux(container, episode, fps)
        shown_s, wanted_s, tolerance_s = np.array(self._pts) * self._tick_s, episode.start_s + times_s, _TOLERANCE / fps
        ranks = np.searchsorted(shown_s, wanted_s - tolerance_s)
        lost = np.flatnonzero(np.append(shown_s, math.inf)[ranks] > wanted_s + tolerance_s)
        self._ranks: list[int] = ranks[: lost[0] if len(lost) else None].tolist()
        stored = int(np.diff(np.searchsorted(shown_s, np.array(episode[2:4]) - tolerance_s))[0])
        what = (
            f"{self._file}: has {stored:,} frames for the {len(times_s):,} rows of {episode.rows}; the first "
            f"{len(self._ranks):,} rows have one within {1e3 * tolerance_s:.2g} ms; {_FETCH}"
        )
        self.damage = () if len(times_s) == stored == len(set(self._ranks)) else (what,)

    def __len__(self) -> int:
        return len(self._ranks)

    def _demux(self, container: Any, episode: _Episode, fps: float) -> None:
        """Read the packets from a keyframe before the episode to its end."""
        stream, digest, is_key = container.streams.video[0], hashlib.sha256(), {}
        context, self._tick_s, size_bytes = stream.codec_context, float(stream.time_base or 0), 0
        digest.update(context.extradata or b"")
        if episode.start_s > 0.0:
            container.seek(max(round((episode.start_s - 1.0 / fps) / self._tick_s), 0), stream=stream)
        for packet in container.demux(stream):
            if packet.pts is None or packet.dts is None or packet.is_corrupt or packet.is_discard:
                continue
            if packet.dts * self._tick_s >= episode.stop_s:
                break
            is_key[packet.pts] = packet.is_keyframe
            size_bytes += packet.size
            digest.update(b"%d " % packet.pts + bytes(packet))
        if not 0 < context.width * context.height <= MAX_PIXELS or not any(is_key.values()):
            raise ValueError(f"{context.width}x{context.height}, {len(is_key)} frames of the episode")
        self._pts = sorted(is_key)
        self._keys = [rank for rank, pts in enumerate(self._pts) if is_key[pts]]
        self.digest, rate_kbps = digest.hexdigest(), 8e-3 * size_bytes * fps / len(is_key)
        coding = f"{context.codec.canonical_name} video, {context.pix_fmt}, {rate_kbps:,.0f} kbit/s"
        self.coding = (already_coded(f"they are {coding}"),)

    def read(self, row: int) -> Image:
        """Decode the RGB image (H, W, 3) of a row. Raises DatasetError."""
        rank = self._ranks[row]
        key = self._keys[max(bisect_right(self._keys, rank) - 1, 0)]
        with _video_errors(self._file):
            if self._process != os.getpid():  # a forked process shares the position in the file
                self._container, self._process, self._rank = _open_video(self._file), os.getpid(), -1
            if not max(key - 1, 0) <= self._rank < rank:
                stream = self._container.streams.video[0]
                self._container.seek(self._pts[key], stream=stream)
                packets = (packet for packet in self._container.demux(stream) if not packet.is_corrupt)
                self._decoded = (frame for packet in packets for frame in packet.decode())
            self._rank = -1
            for frame in self._decoded:
                if frame.pts == self._pts[rank]:
                    self._rank = rank
                    return samples_of_frame(frame, "rgb24")
                if (frame.pts or 0) > self._pts[rank]:
                    break
        raise DatasetError(f"{self._file}: frame {row} of the episode cannot be decoded; {_FETCH}")


def _open_video(file: Path) -> Any:
    """Open an MP4 file to decode in one thread, because threads do not survive a fork."""
    container: Any = load_av().open(str(file), format="mp4", metadata_errors="ignore")
    container.streams.video[0].thread_count = 1
    return container


@contextmanager
def _video_errors(file: Path) -> Iterator[None]:
    """Turn PyAV's errors into a DatasetError."""
    errors: tuple[type[Exception], ...] = (IndexError, *decoding_errors())
    try:
        yield
    except errors as error:
        raise DatasetError(f"{file}: is missing or not a whole MP4 video: {error}; {_FETCH}") from error


def _read_info(root: Path) -> _Info:
    """Read `meta/info.json`. Raises DatasetError."""
    file = root / "meta" / "info.json"
    try:
        return _Info.model_validate_json(file.read_bytes())
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read: {error.strerror}; set `path` to a LeRobot dataset") from error
    except ValidationError as error:
        fault = error.errors()[0]
        what = f"{'.'.join(map(str, fault['loc']))}: {fault['msg']}, not {fault['input']!r:.40}".removeprefix(": ")
        remedy = "convert other versions with LeRobot (convert_dataset_v1_to_v2, convert_dataset_v21_to_v30)"
        raise DatasetError(f"{file}: is not supported: {what}; {remedy}") from error


def _choose_camera(root: Path, features: dict[str, _Feature], name: str | None) -> str:
    """The feature called `name`, in short or in full, else the only camera. Raises DatasetError with a list."""
    cameras = {}
    for key, feature in features.items():
        details, sizes = feature.info or {}, dict(zip(feature.names or (), feature.shape, strict=False))
        is_depth = details.get("is_depth_map") or details.get("video.is_depth_map")  # quantized over a range of its own
        if feature.dtype in ("video", "image") and not is_depth:
            size = f"{sizes.get('width', '?')}x{sizes.get('height', '?')}"
            cameras[key] = f"{key}: {size}, {feature.dtype} {details.get('video.codec', '')}".rstrip()
    matches = [key for key in cameras if name in (None, key, key.rpartition(".")[2])]
    if name in cameras or len(matches) == 1:
        return name if name in cameras else matches[0]
    what = f"{len(cameras)} cameras" if name is None else f"{name!r} is not the name of one camera"
    listed = "".join(f"\n  {line}" for line in cameras.values())
    raise DatasetError(f"{root}: {what}; choose one with `camera`:{listed or ' there is none but of depth'}")


def _find_episode(root: Path, info: _Info, camera: str | None, number: int) -> _Episode:
    """Find the files of an episode and, unless None, of the video `camera`. Raises DatasetError."""
    of_one, file = info.codebase_version < "v3", ("chunk_index", "file_index")
    data = video = {"episode_chunk": number // info.chunks_size, "episode_index": number}
    columns = ["tasks", *([] if of_one else [f"data/{name}" for name in file])]
    if camera is not None and not of_one:
        columns += [f"videos/{camera}/{name}" for name in (*file, "from_timestamp", "to_timestamp")]
    meta = root / "meta" / ("episodes.jsonl" if of_one else "episodes")
    table = _read_episode(meta, number, [(name,) for name in columns])
    if not len(table) or number >= info.total_episodes:
        raise DatasetError(f"{meta}: has {info.total_episodes:,} episodes, counted from 0; `episode` is {number}")
    tasks, *facts = table.to_pylist()[0].values()
    try:
        if not of_one:
            data, video = dict(zip(file, facts[:2], strict=True)), dict(zip(file, facts[2:4], strict=False))
        start_s, stop_s = facts[4:] or (0.0, math.inf)
        video_path = "" if camera is None else str(info.video_path).format(video_key=camera, **video)
        if not 0.0 <= start_s < stop_s:
            raise ValueError(f"the video is from {start_s} to {stop_s} s")
        files = root / info.data_path.format(**data), root / video_path
        return _Episode(*files, start_s, stop_s, "; ".join(map(str, tasks or ()))[:100])
    except (LookupError, TypeError, ValueError, AttributeError, MemoryError) as error:
        raise DatasetError(f"{meta}: does not say where episode {number} is: {error!r}; {_FETCH}") from error


def _read_rows(file: Path, episode: int, camera: str | None) -> tuple[Any, list[bytes]]:
    """Times (N,) of an episode's rows in seconds, and the image files in the column `camera`. Raises DatasetError."""
    table = _read_episode(file, episode, [("timestamp",), *([(camera, "bytes")] if camera else [])])
    times_s, contents = np.array(table[0].to_pylist(), dtype=np.float64), table[-1].to_pylist()
    if times_s.ndim != 1 or not len(times_s) or not np.isfinite(times_s).all() or (np.diff(times_s) <= 0.0).any():
        raise DatasetError(f"{file}: the {len(times_s):,} timestamps of episode {episode} do not increase; {_FETCH}")
    return times_s, [content or b"" for content in contents]


def _read_episode(path: Path, number: int, columns: list[tuple[str, ...]]) -> Any:
    """Read an episode's rows of a Parquet file, a folder of these, or lines of JSON. Raises DatasetError."""
    import pyarrow as pa  # slow, and `codecbench try` asks every dataset whether it recognizes a path
    from pyarrow import dataset

    try:
        rows = dataset.dataset(path, format="json" if path.suffix == ".jsonl" else "parquet")
        wanted = {"/".join(names): dataset.field(*names) for names in columns}
        return rows.to_table(wanted, filter=dataset.field("episode_index") == number, use_threads=False)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(f"{path}: cannot be read: {error}; {_FETCH}") from error
