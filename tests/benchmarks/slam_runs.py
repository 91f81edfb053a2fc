"""SLAM over frames without the engine: what tables are made of, and two by which a change of the SLAM is judged.

python tests/benchmarks/slam_runs.py [--drift] [--sequences NAME ...] [--codecs raw jpeg10] [--starts 5] [--quick]

A row is a sequence, raw or as JPEG at a quality, from so many starts. The real sequences are in the folder that
CODECBENCH_DATA names. Decoded frames are kept in the cache folder. `--quick` takes two starts, and no long sequence.

`--drift` shows how scale drifts without loops, forward and backward, with the camera's calibration as it is and with
each error that `--calibration-errors` names (k1 too large by it, the focal length by half of it).
"""

from __future__ import annotations

import argparse
import hashlib
import math
import os
from itertools import pairwise, product
from pathlib import Path
from typing import Final

import numpy as np

from codecbench import slam
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.sequence import FrameSequence, Trajectory
from codecbench.core.kernels.folders import cache_folder
from codecbench.plugins.codecs.jpeg import Jpeg
from codecbench.plugins.datasets.calibration import miscalibrate
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLDS
from codecbench.plugins.datasets.tum import Tum
from codecbench.plugins.evaluators.trajectory.alignment import Pairs, Undefined, align, associate
from codecbench.plugins.evaluators.trajectory.errors import part_scales, position_errors, rms

REAL: Final = ("fr3_office_715", "sevenscenes_400", "kitti00_half")
DRIFT_PARTS: Final = 5
"""Parts of a path whose scales are compared: enough to see a slip in the middle, few enough to span a turn each."""
DRIFT_HEADS: Final = ("sequence", "codec", "starts", "calibration error", "forward %", "reversed %", "symmetric %",
                      "by order %", "scatter", "median mm", "with a pose %")  # fmt: skip
HEADS: Final = ("sequence", "codec", "starts", "wait", "tracked %", "median mm", "worst", "worst / median", "slip %",
                "worst slip", "maps", "loops")  # fmt: skip


def system_of(sequence: FrameSequence, options: slam.Options | None = None, error: float = 0.0) -> slam.System:
    """A SLAM for the camera of a sequence, or for one that is miscalibrated by `error`."""
    assert sequence.camera is not None
    camera = miscalibrate(sequence.camera, error)
    numbers = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return slam.System(slam.Camera(*numbers, camera.distortion, camera.model), options)


def path_of(result: slam.Result) -> Trajectory:
    """The path of the largest map."""
    return Trajectory(result.trajectory.timestamps_s, result.trajectory.world_from_camera)


def scales_along(pairs: Pairs) -> list[float]:
    """ln of true over estimated scale in each of the DRIFT_PARTS parts of the path.

    Parts have equal lengths of the true path, so the speed of the camera does not matter. Raises Undefined for fewer
    than three poses in a part, or if the camera does not move in one.
    """
    steps_m = np.linalg.norm(np.diff(pairs.reference.positions_world, axis=0), axis=1)
    travelled_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    ends = np.searchsorted(travelled_m, travelled_m[-1] * np.arange(DRIFT_PARTS + 1) / DRIFT_PARTS)
    ends[-1] = len(pairs)
    return part_scales(pairs, tuple(slice(int(first), int(last)) for first, last in pairwise(ends)))


def error_m(found: Trajectory, truth: Trajectory | None, tolerance_s: float = 0.02) -> float:
    """RMS distance from the true path at times that agree, after alignment; infinite where there is no best one."""
    if truth is None:
        return math.nan
    pairs = associate(found, truth, tolerance_s)
    try:
        return rms(position_errors(pairs, align(pairs)))
    except Undefined:
        return math.inf


def opened(name: str, severity: float) -> FrameSequence:
    """A real sequence, or a world at a severity."""
    if name in REAL:
        return Tum.create(path=str(Path(os.environ["CODECBENCH_DATA"]) / name)).open()
    return Synthetic.create(world=name, severity=severity).open()


def frames_of(sequence: FrameSequence, codec: str) -> Image:
    """All frames (N, H, W), gray, as they are or as a codec leaves them, from the cache folder."""
    coder = None if codec == "raw" else Jpeg.create(quality=int(codec.removeprefix("jpeg")))
    key = f"{sequence.fingerprint} {codec} {coder.version if coder else ''}"
    path = cache_folder() / "slam_runs" / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}.npy"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        images = (sequence.read(index).image for index in range(len(sequence)))
        seen = (coder.decode(coder.encode(image)) for image in images) if coder else images
        made = path.with_suffix(f".{os.getpid()}.npy")
        np.save(made, np.array([gray_from_image(image) for image in seen]))
        made.replace(path)
    return np.asarray(np.load(path, mmap_mode="r"))


def outcome(sequence: FrameSequence, frames: Image, start: int, error: float = 0.0) -> list[float]:
    """Frames before the first map, share tracked from there on, error in metres, slip of scale, maps, loops closed."""
    system = system_of(sequence, error=error)
    for index in range(start, len(frames)):
        system.process(np.ascontiguousarray(frames[index]), float(sequence.timestamps_s[index]))
    result = system.finish()
    path = path_of(result)
    wait = next((place for place, frame in enumerate(result.frames) if frame.state == "tracked"), len(frames) - start)
    share = len(path) / max(len(frames) - start - wait, 1)
    assert sequence.ground_truth is not None
    try:
        scales = scales_along(associate(path, sequence.ground_truth, 0.02))
        slip = max(scales) - min(scales)
    except Undefined:
        slip = math.nan
    return [wait, share, error_m(path, sequence.ground_truth), slip, len(result.maps), len(result.loops)]


def row(name: str, codec: str, starts: int, severity: float, error: float) -> list[str]:
    """Medians over the starts and the worst of them."""
    sequence = opened(name, severity)
    frames = frames_of(sequence, codec)
    outcomes = np.array([outcome(sequence, frames, start, error) for start in range(starts)])
    wait, share, errors, slip, maps, loops = outcomes.T
    middle, slips = 1e3 * float(np.median(errors)), 100 * slip
    return [
        name, codec, str(starts), f"{np.median(wait):.0f}, {wait.max():.0f}", f"{100 * share.min():.1f}",
        f"{middle:.4g}", f"{1e3 * errors.max():.4g}", f"{1e3 * errors.max() / middle:.2g}", f"{np.median(slips):.2f}",
        f"{slips.max():.2f}", f"{maps.max():.0f}", f"{loops.min():.0f}",
    ]  # fmt: skip


def played(sequence: FrameSequence, frames: Image, start: int, reverse: bool, error: float) -> tuple[float, ...]:
    """Without loops, forward or backward: growth of the estimated scale from the first fifth of the way to the last (in
    the order of the recording), error in metres, share of frames with a pose."""
    options = slam.Options(loop_closing=False)
    system = system_of(sequence, options, error)
    stamps_s = sequence.timestamps_s
    turned_s = stamps_s[0] + stamps_s[-1] - stamps_s  # of frames played backward; turned again, it is the recording's
    order = range(len(frames) - 1 - start, -1, -1) if reverse else range(start, len(frames))
    for index in order:
        stamp_s = turned_s[index] if reverse else stamps_s[index]
        system.process(np.ascontiguousarray(frames[index]), float(stamp_s))
    path = path_of(system.finish())
    if reverse:
        path = Trajectory(stamps_s[0] + stamps_s[-1] - path.timestamps_s[::-1], path.world_from_camera[::-1])
    share = len(path) / len(order)
    try:
        scales = scales_along(associate(path, sequence.ground_truth, 0.02))
    except Undefined:
        return math.nan, error_m(path, sequence.ground_truth), share
    return scales[0] - scales[-1], error_m(path, sequence.ground_truth), share


def drift_row(name: str, codec: str, starts: int, severity: float, error: float) -> list[str]:
    """Medians over the starts. The symmetric part, half the sum of both directions, does not depend on the order of the
    frames; the part by order, half the difference, is made by processing; its scatter is half of its range."""
    sequence = opened(name, severity)
    frames = frames_of(sequence, codec)
    both = [[played(sequence, frames, start, way, error) for start in range(starts)] for way in (False, True)]
    drifts, errors, shares = np.moveaxis(np.array(both), 2, 0)
    forward, backward = 100 * drifts
    symmetric, by_order = (forward + backward) / 2, (forward - backward) / 2
    columns = (forward, backward, symmetric, by_order)
    return [
        name, codec, str(starts), f"{error:g}", *(f"{np.median(column):.2f}" for column in columns),
        f"{np.ptp(by_order) / 2:.2f}", f"{1e3 * np.median(errors[0]):.4g}", f"{100 * shares.min():.1f}",
    ]  # fmt: skip


def main() -> None:
    """Print the table, each row as soon as it is known."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    names = [*WORLDS, *REAL]
    parser.add_argument("--sequences", nargs="+", default=names, choices=names)
    codecs = ["raw", "jpeg20", "jpeg10", "jpeg5"]
    parser.add_argument("--codecs", nargs="+", default=["raw", "jpeg10"], choices=codecs)
    parser.add_argument("--starts", type=int, default=5)
    parser.add_argument("--severity", type=float, default=0.5)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--drift", action="store_true")
    parser.add_argument("--calibration-errors", nargs="+", type=float, default=[0.0])
    args = parser.parse_args()
    chosen = [name for name in args.sequences if not (args.quick and name == "kitti00_half")]
    heads = DRIFT_HEADS if args.drift else HEADS
    starts = 2 if args.quick else args.starts
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for name, codec in product(chosen, args.codecs):
        for error in args.calibration_errors:
            cells = (drift_row if args.drift else row)(name, codec, starts, args.severity, error)
            print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
