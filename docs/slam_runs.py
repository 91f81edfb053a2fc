"""SLAM over frames without the engine: what tables are made of, and a table by which a change of the SLAM is judged.

python docs/slam_runs.py [--sequences NAME ...] [--codecs raw jpeg10] [--starts 5] [--severity 0.5] [--quick]

A row is a sequence, raw or as JPEG at a quality, from so many starts. The real sequences are in the folder that
CODECBENCH_DATA names. Decoded frames are kept in the cache folder. `--quick` takes two starts, and no long sequence.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np

from codecbench import slam
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.sequence import FrameSequence, Trajectory
from codecbench.core.kernels.cache_folder import cache_folder
from codecbench.plugins.codecs.jpeg import Jpeg
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLDS
from codecbench.plugins.datasets.tum import Tum
from codecbench.plugins.evaluators.trajectory.alignment import Undefined, align, associate
from codecbench.plugins.evaluators.trajectory.errors import position_errors, rms, scale_slip

REAL: Final = ("fr3_office_715", "sevenscenes_400", "kitti00_half")
HEADS: Final = ("sequence", "codec", "starts", "wait", "tracked %", "median mm", "worst", "worst / median", "slip %",
                "worst slip", "maps", "loops")  # fmt: skip


def system_of(sequence: FrameSequence, features: int = 1000) -> slam.System:
    """A SLAM for the camera of a sequence."""
    camera = sequence.camera
    assert camera is not None
    numbers = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return slam.System(slam.Camera(*numbers, camera.distortion, camera.model), slam.Options(features=features))


def path_of(result: slam.Result) -> Trajectory:
    """The path of the largest map."""
    return Trajectory(result.trajectory.timestamps_s, result.trajectory.world_from_camera)


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


def outcome(sequence: FrameSequence, frames: Image, start: int) -> list[float]:
    """Frames before the first map, share tracked from there on, error in metres, slip of scale, maps, loops closed."""
    system = system_of(sequence)
    for index in range(start, len(frames)):
        system.process(np.ascontiguousarray(frames[index]), float(sequence.timestamps_s[index]))
    result = system.finish()
    path = path_of(result)
    wait = next((place for place, frame in enumerate(result.frames) if frame.state == "tracked"), len(frames) - start)
    share = len(path) / max(len(frames) - start - wait, 1)
    assert sequence.ground_truth is not None
    try:
        slip = scale_slip(associate(path, sequence.ground_truth, 0.02))
    except Undefined:
        slip = math.nan
    return [wait, share, error_m(path, sequence.ground_truth), slip, len(result.maps), len(result.loops)]


def row(name: str, codec: str, starts: int, severity: float) -> list[str]:
    """Medians over the starts and the worst of them."""
    sequence = opened(name, severity)
    frames = frames_of(sequence, codec)
    outcomes = np.array([outcome(sequence, frames, start) for start in range(starts)])
    wait, share, error, slip, maps, loops = outcomes.T
    middle, slips = 1e3 * float(np.median(error)), 100 * slip
    return [
        name, codec, str(starts), f"{np.median(wait):.0f}, {wait.max():.0f}", f"{100 * share.min():.1f}",
        f"{middle:.4g}", f"{1e3 * error.max():.4g}", f"{1e3 * error.max() / middle:.2g}", f"{np.median(slips):.2f}",
        f"{slips.max():.2f}", f"{maps.max():.0f}", f"{loops.min():.0f}",
    ]  # fmt: skip


def rows(names: list[str], codecs: list[str], starts: int, severity: float) -> Iterator[list[str]]:
    for name in names:
        for codec in codecs:
            yield row(name, codec, starts, severity)


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
    args = parser.parse_args()
    chosen = [name for name in args.sequences if not (args.quick and name == "kitti00_half")]
    print(f"| {' | '.join(HEADS)} |\n|{'---|' * len(HEADS)}")
    for cells in rows(chosen, args.codecs, 2 if args.quick else args.starts, args.severity):
        print(f"| {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
