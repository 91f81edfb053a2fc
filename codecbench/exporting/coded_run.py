"""What viewers show of a run: frames of one codec setting on one sequence, their values, and the camera's path."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from codecbench.core.analysis.replanning import openable_params
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.engine.hosting.host import limit_s
from codecbench.core.engine.planning.model import CodingJob
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.running.workbench import Workbench
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.store import Store
from codecbench.plugins.evaluators.trajectory import files
from codecbench.plugins.evaluators.trajectory.alignment import nearest_stamps

Values = dict[str, NDArray[np.float64]]
"""Values of frames (frames,) by name, NaN where there is none."""


class CameraPath(NamedTuple):
    """Poses of the camera."""

    times_ns: list[int]
    world_from_camera: NDArray[np.float64]
    """(N, 4, 4), in meters if the sequence has ground truth."""


@dataclass(frozen=True)
class CodedRun:
    """One codec setting on one sequence; frames are read and decoded on demand."""

    job: CodingJob
    coded: CodedSequence
    times_ns: list[int]
    """Capture time of each frame, see `time_ns`."""
    values: dict[str, Values]
    """By evaluator, from its first computed repeat; `codec` has the sizes of the bitstreams."""
    paths: dict[str, CameraPath]
    """`truth` during the frames, and `estimate` of the chosen SLAM run; each only if there is one."""

    @property
    def title(self) -> str:
        """Codec, setting and sequence."""
        return f"{self.job.codec.name} {self.job.codec.label}".strip() + f" on {self.job.sequence.name}"


def time_ns(time_s: float) -> int:
    """Convert seconds to nanoseconds, of the shortest decimal that is this double: times of 6 decimals stay exact.

    A double of seconds since 1970 is 240 ns from the next, and multiplied by 1e9 it would be rounded once more.
    """
    return int(Decimal(repr(float(time_s))).scaleb(9).to_integral_value())


@contextmanager
def open_coded_run(
    store: Store,
    job: CodingJob,
    results: tuple[CellResult, ...],
    slam: CellResult | None,
    sequences_from: str | None = None,
) -> Iterator[CodedRun]:
    """Open the sequence and the bitstreams of a job. results: of its cells; slam: the one whose path is shown.

    Plugins of other distributions run in hosts until the block ends. Raises DatasetError if the sequence may not be
    opened, see `openable_params`, or has times below 0, and BitstreamDamage for missing or damaged bitstreams.
    """
    params = openable_params(store.folder, job.sequence, sequences_from)
    plugins = Workbench(limit_s)
    try:
        dataset = replace(job.sequence.dataset, params=params)
        sequence = plugins.sequence(replace(job.sequence, dataset=dataset), cache_bytes=0)
        bitstreams = BitstreamFile(store.coded_path(job.id).absolute(), job.id)
        coded = CodedFrames(sequence, plugins.create(job.codec, job.id), bitstreams, WorkPosition())
        times_ns = [time_ns(time_s) for time_s in sequence.timestamps_s]
        if times_ns[0] < 0:
            raise DatasetError(f"{sequence.name} begins at {times_ns[0]} ns; viewers take times from 0")
        sizes = np.array([float(coded.size_bytes(index)) for index in range(len(coded))])
        values = {"codec": {"size_bytes": sizes}} | _values(results, slam)
        yield CodedRun(job, coded, times_ns, values, _paths(coded, times_ns, slam))
    finally:
        plugins.end()


def _values(results: tuple[CellResult, ...], slam: CellResult | None) -> dict[str, Values]:
    """Values of frames by evaluator, and the error of each frame's position in the drawing of the SLAM run."""
    by_evaluator: dict[str, Values] = {}
    for result in results:
        title = _identifier(result.cell.evaluator.title)
        if result.status != "ok" or title in by_evaluator:
            continue
        samples = result.frames()
        samples["stage"] = samples["stage"].astype(object).where(samples["stage"].notna(), "")
        by_evaluator[title] = {
            _identifier(f"{metric}_{stage}"): _column(result, group["frame"].to_numpy(), group["value"].to_numpy())
            for (metric, stage), group in samples.groupby(["metric", "stage"], sort=False, observed=True)
        }
    drawing = None if slam is None else slam.drawing()
    if slam is not None and drawing is not None and (timeline := drawing.timeline) is not None:
        name = _identifier(f"{timeline.quantity}_{timeline.unit}")
        by_evaluator[_identifier(slam.cell.evaluator.title)][name] = _column(slam, timeline.frames, timeline.errors)
    return {title: values for title, values in by_evaluator.items() if values}


def _column(result: CellResult, frames: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    column = np.full(result.cell.sequence.frames, np.nan)
    column[frames] = values
    return column


def _identifier(text: str) -> str:
    """A name that paths of messages and entities take as it is: `time_ms_encode_dct`."""
    return re.sub(r"\W+", "_", text).strip("_")


def _paths(coded: CodedSequence, times_ns: list[int], slam: CellResult | None) -> dict[str, CameraPath]:
    """The true path during the frames, unturned if its rotations are unknown, and the estimate at times of frames."""
    paths, truth, stamps_s = {}, coded.sequence.ground_truth, coded.sequence.timestamps_s
    if truth is not None:
        during = (truth.timestamps_s >= stamps_s[0]) & (truth.timestamps_s <= stamps_s[-1])
        poses = truth.world_from_camera[during]
        poses = np.where(np.isnan(poses), np.eye(4), poses)
        paths["truth"] = CameraPath(list(map(time_ns, truth.timestamps_s[during])), poses)
    if slam is not None:
        estimate = files.read_tum(slam.folder / files.TRAJECTORY)  # stamps have microseconds
        frames = nearest_stamps(estimate.timestamps_s, np.asarray(stamps_s), 0.0)
        paths["estimate"] = CameraPath(
            [times_ns[frame] for frame in frames[frames >= 0]], estimate.world_from_camera[frames >= 0]
        )
    return {name: path for name, path in paths.items() if path.times_ns}
