"""Writes a coded run as an RRD file for the Rerun viewer. Needs the extra `rerun`."""

from __future__ import annotations

import ctypes
import errno
import os
import warnings
from pathlib import Path
from typing import Any, Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import CodedFrame
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Depth
from codecbench.core.engine.storage import atomic
from codecbench.core.engine.text import counted
from codecbench.exporting.coded_run import CodedRun
from codecbench.plugins.evaluators.features import Features

_TIMELINE: Final = "time"
_MOST_S: Final = 20.0
"""Time limit for writing a frame; the library waits forever for a disk that is full."""
_HINT: Final = "see whether the disk is full"
_KEPT, _LOST, _FOUND = (70, 190, 90), (220, 60, 60), (80, 150, 255)
_COLORS: Final = {"truth": (140, 145, 155), "estimate": (240, 140, 40)}


def write(run: CodedRun, out: Path, coded: bool) -> str:
    """Write raw and decoded frames, keypoints, values and paths to `out`, and return a sentence about the file.

    The time of what is logged is that of its frame or pose. Raises Unsupported if `coded` asks for bitstreams.
    """
    if coded:
        raise Unsupported(f"{out} takes decoded frames only; leave out --coded, or write an .mcap file")
    recording: Any = rr.RecordingStream("codecbench")
    with atomic.open_whole(out) as stream:
        recording.save(f"/dev/fd/{stream.fileno()}")
        recording.send_recording_name(run.title)
        recording.send_blueprint(_blueprint(run))
        _log_values(recording, run)
        _log_paths(recording, run)
        detector = Features.create() if run.coded.sequence.bits == 8 else None
        for index, time_ns in enumerate(run.times_ns):
            recording.set_time(_TIMELINE, timestamp=np.datetime64(time_ns, "ns"))
            recording.set_time("frame", sequence=index)
            _log_frame(recording, run.coded.frame(index), run.coded.sequence.depth, detector)
            _flush(recording, out)
        recording.disconnect()
        _check_end(f"/dev/fd/{stream.fileno()}", out)
        size = stream.seek(0, os.SEEK_END)
    return f"{out}: {run.title}, {counted(len(run.coded), 'frame')}, {size / 1e6:.1f} MB"


def _flush(recording: Any, out: Path) -> None:
    """Wait until what was logged is in the file, so that it does not pile up in memory."""
    try:
        recording.flush(timeout_sec=_MOST_S)
    except RuntimeError as error:  # which says why only on stderr
        # The library would wait for its thread forever: when the process ends, and when the recording is freed.
        rr.unregister_shutdown()
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(recording))
        raise OSError(errno.EIO, f"{error}; {_HINT}", str(out)) from error


def _check_end(file: str, out: Path) -> None:
    """Raise OSError if the file has no footer; that it could not be written the library says only on stderr."""
    try:
        with warnings.catch_warnings(action="ignore"):
            RrdReader(file).store()
    except Exception as error:
        raise OSError(errno.EIO, f"its end is missing; {_HINT}", str(out)) from error


def _log_frame(recording: Any, frame: CodedFrame, depth: Depth | None, detector: Features | None) -> None:
    recording.log("camera/raw", _picture(frame.original.image, depth))
    recording.log("camera/decoded", _picture(frame.decoded, depth))
    if detector is not None:
        found = detector.keypoints(frame)
        colors = np.where((found.partners >= 0)[:, None], _KEPT, _LOST).astype(np.uint8)
        recording.log("camera/raw/keypoints", rr.Points2D(found.original.places[:, :2], colors=colors))
        recording.log("camera/decoded/keypoints", rr.Points2D(found.decoded.places[:, :2], colors=_FOUND))


def _picture(image: Image, depth: Depth | None) -> Any:
    return rr.Image(image) if depth is None else rr.DepthImage(image, meter=1.0 / depth.unit_m)


def _times(times_ns: list[int]) -> list[Any]:
    return [rr.TimeColumn(_TIMELINE, timestamp=np.array(times_ns, "datetime64[ns]"))]


def _log_values(recording: Any, run: CodedRun) -> None:
    """Finite values only, as a plot has no place for others."""
    for title, columns in run.values.items():
        for name, values in columns.items():
            known = np.flatnonzero(np.isfinite(values))
            if len(known):
                times = _times([run.times_ns[frame] for frame in known])
                recording.send_columns(f"values/{title}/{name}", times, rr.Scalars.columns(scalars=values[known]))


def _log_paths(recording: Any, run: CodedRun) -> None:
    """The whole path as a line at any time, and a point where the camera is."""
    for name, path in run.paths.items():
        positions: NDArray[np.float64] = path.world_from_camera[:, :3, 3]
        recording.log(f"paths/{name}", rr.LineStrips3D([positions], colors=_COLORS[name]), static=True)
        points = rr.Points3D.columns(positions=positions)
        recording.send_columns(f"paths/{name}/camera", _times(path.times_ns), points)


def _blueprint(run: CodedRun) -> Any:
    """Raw beside decoded frames and paths; below, the size of frames beside a tab for each other value."""
    views = [
        rrb.Spatial2DView(origin="camera/raw", name="raw"),
        rrb.Spatial2DView(origin="camera/decoded", name=run.title),
        *([rrb.Spatial3DView(origin="paths", name="paths")] if run.paths else []),
    ]
    plots = [
        rrb.TimeSeriesView(origin=f"values/{title}/{name}", name=f"{title} {name}")
        for title, columns in sorted(run.values.items(), key=lambda pair: pair[0] not in ("codec", "trajectory"))
        for name in columns
    ]
    return rrb.Blueprint(
        rrb.Vertical(rrb.Horizontal(*views), rrb.Horizontal(plots[0], rrb.Tabs(*plots[1:])), row_shares=[2, 1]),
        collapse_panels=True,
    )
