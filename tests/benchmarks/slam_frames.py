"""Where the time of a SLAM frame goes, how long frames take, and how memory grows, as Markdown tables.

    python tests/benchmarks/slam_frames.py office=$CODECBENCH_DATA/fr3_office_715 street=$CODECBENCH_DATA/kitti00_half@2

runs `codecbench.slam` on the gray images of each folder in TUM's layout, enlarged where `@FACTOR` says so, after a
short run that compiles. Times are CPU time of the process. With `--memory FRAMES` the images are shown forth and back
until there were so many frames, and only memory is measured.
"""

from __future__ import annotations

import argparse
import dataclasses
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from codecbench import slam
from codecbench.core.contracts.image import gray_from_image
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.report.tables import table
from codecbench.slam.atlas import Atlas, TrackedMap
from codecbench.slam.features import extractor
from codecbench.slam.mapping.initialization import Initializer
from codecbench.slam.mapping.mapper import Mapper
from codecbench.slam.places.recognition import PlaceRecognition
from codecbench.slam.tracking import tracker

STEPS: dict[str, tuple[tuple[Any, str], ...]] = {
    "features: pyramid": ((extractor.FeatureExtractor, "_pyramid"),),
    "features: corners, found and chosen": ((extractor, "find_corners"),),
    "features: orientation, smoothing, descriptors": ((extractor, "describe_corners"),),
    "features: the rest": ((extractor.FeatureExtractor, "extract"),),
    "tracking: points of the last frame": ((tracker, "search_last_frame"),),
    "tracking: local map": ((tracker.Tracker, "_local_points"), (tracker, "search_local_map")),
    "tracking: pose": ((tracker, "optimize_matched_pose"),),
    "tracking: the rest": ((tracker.Tracker, "track"), (TrackedMap, "record"), (TrackedMap, "wants_keyframe")),
    "mapping: triangulation": ((Mapper, "_triangulate"),),
    "mapping: fusion": ((Mapper, "_fuse_neighborhood"),),
    "mapping: local bundle adjustment": ((Mapper, "adjust_locally"),),
    "mapping: culling": ((Mapper, "_cull_points"), (Mapper, "_cull_keyframes")),
    "mapping: the rest": ((Mapper, "insert"), (Mapper, "refine_neighborhood")),
    "places: words and index": ((PlaceRecognition, "add"), (PlaceRecognition, "remove")),
    "places: loops, merging, relocalization": ((TrackedMap, "close_loop"), (Atlas, "merge"), (Atlas, "relocalize")),
    "initialisation": ((Initializer, "add"),),
    "everything else": ((slam.System, "process"),),
}
"""What is timed under which name: functions and methods, by the module or class that they are looked up in."""


class StepTimer:
    """CPU time of the steps, each without the steps that it calls."""

    def __init__(self) -> None:
        self.spent_ns = dict.fromkeys(STEPS, 0)
        self._inner_ns: list[int] = []

    def watch(self) -> None:
        """Time every call of the functions in STEPS from now on."""
        for step, functions in STEPS.items():
            for owner, name in functions:
                setattr(owner, name, self._timed(getattr(owner, name), step))

    def _timed(self, function: Callable[..., Any], step: str) -> Callable[..., Any]:
        def timed(*args: Any, **options: Any) -> Any:
            begun = time.process_time_ns()
            self._inner_ns.append(0)
            try:
                return function(*args, **options)
            finally:
                taken = time.process_time_ns() - begun
                self.spent_ns[step] += taken - self._inner_ns.pop()
                if self._inner_ns:
                    self._inner_ns[-1] += taken

        return timed


@dataclass(frozen=True)
class Pictures:
    """Gray images with their times in seconds, and the camera that took them."""

    name: str
    camera: slam.Camera
    images: list[np.ndarray]
    times_s: list[float]


def read(name: str, folder: str, factor: float) -> Pictures:
    """The images of a folder in TUM's layout, enlarged."""
    sequence = installed().create("dataset", "tum", {"path": folder}).open()
    c, images, times_s = sequence.camera, [], []
    width, height = round(c.width * factor), round(c.height * factor)
    for frame in sequence:
        gray = gray_from_image(frame.image)
        if factor != 1.0:
            gray = cv2.resize(gray, (width, height), interpolation=cv2.INTER_CUBIC)
        images.append(np.ascontiguousarray(gray))
        times_s.append(frame.timestamp_s)
    cx, cy = (c.cx + 0.5) * factor - 0.5, (c.cy + 0.5) * factor - 0.5
    camera = slam.Camera(width, height, c.fx * factor, c.fy * factor, cx, cy, c.distortion)
    return Pictures(name, camera, images, times_s)


def frame_times_ms(pictures: Pictures, frames: int) -> tuple[np.ndarray, np.ndarray, slam.System]:
    """CPU time of each frame (N,), which of them became keyframes (N,), and the system as it is then."""
    system, taken, keyframes = slam.System(pictures.camera, seed=0), [], []
    for image, timestamp_s in zip(pictures.images[:frames], pictures.times_s, strict=False):
        begun = time.process_time()
        keyframes.append(system.process(image, timestamp_s).keyframe)
        taken.append(1e3 * (time.process_time() - begun))
    return np.array(taken), np.array(keyframes), system


def step_row(step: str, spent_ms: dict[str, dict[str, float]]) -> list[str]:
    """A step's milliseconds a frame and share, by sequence."""
    return [
        step,
        *(f"{spent[step]:.2f} ms, {100 * spent[step] / sum(spent.values()):.0f} %" for spent in spent_ms.values()),
    ]


def times_row(pictures: Pictures, taken: np.ndarray, keyframes: np.ndarray) -> list[str]:
    """How the times of a sequence's frames are distributed."""
    size = f"{pictures.camera.width:,}x{pictures.camera.height}"
    percentiles = np.percentile(taken, [50, 95, 99, 100])
    means = taken.mean(), *percentiles, taken[keyframes].mean(), taken[~keyframes].mean()
    return [f"{pictures.name}, {size}", str(len(taken)), *(f"{value:.1f}" for value in means)]


def array_bytes(root: Any) -> int:
    """Bytes of all arrays that an object holds, each once."""
    seen: dict[int, int] = {}
    waiting, met = [root], set()
    while waiting:
        found = waiting.pop()
        if isinstance(found, np.ndarray):
            owner = found if found.base is None else found.base
            seen[id(owner)] = getattr(owner, "nbytes", found.nbytes)
        elif id(found) not in met and not isinstance(found, str | bytes | int | float | type | Callable):  # type: ignore[arg-type]
            met.add(id(found))
            waiting.extend(parts(found))
    return sum(seen.values())


def parts(found: Any) -> Iterator[Any]:
    """What an object is made of."""
    if isinstance(found, dict):
        yield from found.values()
    elif isinstance(found, list | tuple | set | frozenset):
        yield from found
    elif dataclasses.is_dataclass(found) or type(found).__module__.startswith("codecbench.slam"):
        yield from vars(found).values()


def memory_rows(pictures: Pictures, frames: int) -> Iterator[list[str]]:
    """What a run holds after a tenth of the frames, a half and all of them, shown forth and back."""
    count, interval_s = len(pictures.images), float(np.median(np.diff(pictures.times_s)))
    system = slam.System(pictures.camera, seed=0)
    for number in range(frames):
        turn, place = divmod(number, count)
        system.process(pictures.images[place if turn % 2 == 0 else count - 1 - place], number * interval_s)
        if number + 1 in (frames // 10, frames // 2, frames):
            made = sum(slam_map.keyframes.count for slam_map in system.maps)
            left = sum(len(slam_map.alive_keyframes) for slam_map in system.maps)
            points = sum(slam_map.points.count for slam_map in system.maps)
            megabytes = array_bytes(system) / 1e6
            counts = [f"{n:,}" for n in (number + 1, made, left, points)]
            yield [pictures.name, *counts, f"{megabytes:.0f} MB", f"{1e3 * megabytes / (number + 1):.0f} kB"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sequences", nargs="+", metavar="NAME=FOLDER[@FACTOR]")
    parser.add_argument("--frames", type=int, default=715, help="most frames of a sequence")
    parser.add_argument("--memory", type=int, metavar="FRAMES", help="measure memory over so many frames instead")
    chosen = parser.parse_args()
    every = []
    for text in chosen.sequences:
        name, _, place = text.partition("=")
        folder, _, factor = place.rpartition("@") if "@" in place else (place, "", "")
        every.append(read(name, folder, float(factor or 1.0)))
    if chosen.memory:
        heads = ("sequence", "frames", "keyframes made", "left", "points made", "arrays", "a frame")
        print(table(heads, [row for pictures in every for row in memory_rows(pictures, chosen.memory)]))
        return
    rows, spent_ms = [], {}
    for pictures in every:
        frame_times_ms(pictures, 60)  # compile
        rows.append(times_row(pictures, *frame_times_ms(pictures, chosen.frames)[:2]))
    timer = StepTimer()
    timer.watch()
    for pictures in every:
        timer.spent_ns = dict.fromkeys(STEPS, 0)
        count = len(frame_times_ms(pictures, chosen.frames)[0])
        spent_ms[pictures.name] = {step: 1e-6 * spent / count for step, spent in timer.spent_ns.items()}
    print(table(("step", *spent_ms), [step_row(step, spent_ms) for step in STEPS]))
    heads = ("frames of", "number", "mean", "median", "95 %", "99 %", "worst", "keyframes", "others")
    print(table(heads, rows))


if __name__ == "__main__":
    main()
