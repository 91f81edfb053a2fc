"""Pictures and tables of docs/worlds.md that need no run.

python docs/world_tables.py sheet                 writes docs/images/worlds.jpg
python docs/world_tables.py conditions            prints what severity moves in each world
python docs/world_tables.py rendering             prints the time that a frame takes at severity 0.5 and 1
python docs/world_tables.py realism               prints statistics of the worlds' frames beside those of real ones

The last reads the folder that CODECBENCH_DATA names. `docs/tables.py --printed conditions=FILE` puts what the second
printed into the page.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.synthetic.worlds.conditions import moved
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLDS
from codecbench.plugins.datasets.synthetic.worlds.sequence import WorldSequence
from codecbench.plugins.datasets.tum import Tum

SHEET = Path(__file__).parent / "images" / "worlds.jpg"
REAL = ("fr3_office_715", "kitti00_half")
_AREA = 640 * 480
_TILE = (200, 150)
_SEVERITIES = (0.0, 0.5, 1.0)


def statistics(image: Image) -> tuple[float, float, float]:
    """Slope of the power spectrum, bits a pixel as JPEG at quality 50, ORB keypoints on an area of 640 x 480."""
    gray = gray_from_image(image)
    coded = cv2.imencode(".jpg", gray, [cv2.IMWRITE_JPEG_QUALITY, 50])[1]
    keypoints = cv2.ORB_create(20000).detect(gray)  # type: ignore[attr-defined]
    return spectrum_slope(gray), 8.0 * len(coded) / gray.size, len(keypoints) * _AREA / gray.size


def spectrum_slope(gray: Image) -> float:
    """The exponent of power over frequency, from 8 periods a picture's height to 0.35 periods a pixel."""
    side = min(gray.shape)
    top, left = ((length - side) // 2 for length in gray.shape)
    middle = gray[top : top + side, left : left + side].astype(float)
    window = np.hanning(side)
    power = np.abs(np.fft.fft2((middle - middle.mean()) * np.outer(window, window))) ** 2
    frequencies = np.fft.fftfreq(side)
    radius = np.hypot(frequencies[:, None], frequencies)
    edges = np.geomspace(8 / side, 0.35, 13)
    ring = np.digitize(radius, edges)
    means = [power[ring == k].mean() for k in range(1, len(edges))]
    return float(np.polyfit(np.log(np.sqrt(edges[1:] * edges[:-1])), np.log(means), 1)[0])


def spread(sequence: FrameSequence, frames: int = 6) -> NDArray[np.float64]:
    """Statistics (3, 3) over evenly spaced frames: least, median and largest of each."""
    chosen = np.linspace(0, len(sequence) - 1, frames).astype(int)
    values = np.array([statistics(sequence.read(int(index)).image) for index in chosen])
    return np.array([values.min(axis=0), np.median(values, axis=0), values.max(axis=0)])


def real_sequences() -> Iterator[tuple[str, FrameSequence]]:
    folder = os.environ.get("CODECBENCH_DATA")
    if not folder:
        raise SystemExit("CODECBENCH_DATA names no folder; set it to the one that holds the real sequences")
    for name in REAL:
        yield name, Tum.create(path=Path(folder) / name).open()


def realism() -> Iterator[str]:
    yield from (_row(name, "", spread(sequence)) for name, sequence in real_sequences())
    for world in WORLDS:
        yield _row(f"`{world}`", "0.5", spread(Synthetic.create(world=world, severity=0.5).open()))


def _row(name: str, severity: str, values: NDArray[np.float64]) -> str:
    shown = [f"{values[1, k]:.{d}f} ({values[0, k]:.{d}f} ... {values[2, k]:.{d}f})" for k, d in enumerate((2, 2, 0))]
    return f"| {name} | {severity} | {shown[0]} | {shown[1]} | {shown[2]} |"


def rendering() -> Iterator[str]:
    """Processor time a frame at two severities, the median of twelve, after the first."""
    for world in WORLDS:
        medians_ms = []
        for severity in (0.5, 1.0):
            sequence = Synthetic.create(world=world, severity=severity).open()
            assert isinstance(sequence, WorldSequence)
            times_ms = []
            for source in np.linspace(0, len(sequence) - 1, 13).astype(int):
                before_s = time.process_time()
                sequence.render(int(source))
                times_ms.append(1000 * (time.process_time() - before_s))
            medians_ms.append(np.median(times_ms[1:]))
        yield f"| `{world}` | {medians_ms[0]:.0f} ms | {medians_ms[1]:.0f} ms |"


def conditions() -> Iterator[str]:
    for name, world in WORLDS.items():
        scaled = ", ".join(
            f"{field} {low:g} → {high:g}" for field, (low, high) in moved(world.calm, world.hard).items()
        )
        size = f"{world.width} x {world.height}, {world.rate_hz:g} Hz"
        yield f"| `{name}` | {world.about} | {size} | {world.frames(0.5, world.rate_hz)} | {scaled} |"


def sheet() -> Iterator[str]:
    """Write one row a world: a frame at severity 0, one at 0.5 and one at 1."""
    rows = []
    for name, world in WORLDS.items():
        tiles = []
        for severity in _SEVERITIES:
            sequence = Synthetic.create(world=name, severity=severity).open()
            image = sequence.read(int(0.37 * len(sequence))).image
            width = image.shape[0] * 4 // 3
            left = (world.width - width) // 2
            tiles.append(cv2.resize(image[:, left : left + width], _TILE, interpolation=cv2.INTER_AREA))
        label = f"{name}: severity 0, 0.5, 1"
        row = np.hstack(tiles)
        for color, thickness in (((0, 0, 0), 3), ((255, 255, 255), 1)):
            cv2.putText(row, label, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.45, color, thickness, cv2.LINE_AA)
        rows.append(row)
    if len(rows) % 2:
        rows.append(np.full_like(rows[0], 255))
    pairs = [np.hstack(rows[k : k + 2]) for k in range(0, len(rows), 2)]
    SHEET.parent.mkdir(exist_ok=True)
    SHEET.write_bytes(cv2.imencode(".jpg", np.vstack(pairs)[:, :, ::-1], [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes())
    yield (f"{SHEET}: {SHEET.stat().st_size / 1000:.0f} kB")


def main() -> None:
    made = {"sheet": sheet, "rendering": rendering, "realism": realism, "conditions": conditions}
    if not sys.argv[1:] or not set(sys.argv[1:]) <= set(made):
        raise SystemExit(__doc__)
    for name in sys.argv[1:]:
        for row in made[name]():
            print(row, flush=True)


if __name__ == "__main__":
    main()
