"""Frames of the worlds are like those of real cameras, and docs/worlds.md explains what severity moves."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from project import DOCS

from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.synthetic.worlds.conditions import changing_conditions
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLDS
from codecbench.plugins.datasets.tum import Tum

PAGE = (DOCS / "worlds.md").read_text()
SHEET = DOCS / "images" / "worlds.jpg"


def test_what_severity_moves_is_explained() -> None:
    for world in WORLDS.values():
        for name in changing_conditions(world.calm, world.hard):
            assert f"| `{name}` |" in PAGE, f"{name} is not explained"


def test_the_contact_sheet_is_there_and_small() -> None:
    assert cv2.imread(str(SHEET)).shape[0] >= (len(WORLDS) + 1) // 2 * 100
    assert SHEET.stat().st_size < 300_000


def statistics(image: Image) -> tuple[float, float, float]:
    """Slope of the power spectrum, bits a pixel as JPEG at quality 50, ORB keypoints on an area of 640 x 480."""
    gray = gray_from_image(image)
    coded = cv2.imencode(".jpg", gray, [cv2.IMWRITE_JPEG_QUALITY, 50])[1]
    keypoints = cv2.ORB_create(20000).detect(gray)  # type: ignore[attr-defined]
    return spectrum_slope(gray), 8.0 * len(coded) / gray.size, len(keypoints) * 640 * 480 / gray.size


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


def spread(sequence: FrameSequence) -> NDArray[np.float64]:
    """Statistics (3, 3) over six evenly spaced frames: least, median and largest of each."""
    chosen = np.linspace(0, len(sequence) - 1, 6).astype(int)
    values = np.array([statistics(sequence.read(int(index)).image) for index in chosen])
    return np.array([values.min(axis=0), np.median(values, axis=0), values.max(axis=0)])


def test_the_slope_of_a_spectrum_is_that_of_noise_made_with_it() -> None:
    rng = np.random.default_rng(1)
    frequencies = np.fft.fftfreq(256)
    radius = np.hypot(frequencies[:, None], frequencies)
    radius[0, 0] = 1.0
    for exponent in (2.0, 3.0):
        spectrum = np.fft.fft2(rng.standard_normal((256, 256))) / radius ** (exponent / 2)
        gray = np.fft.ifft2(spectrum).real
        gray = np.clip(128 + 30 * gray / gray.std(), 0, 255).astype(np.uint8)
        assert spectrum_slope(gray) == pytest.approx(-exponent, abs=0.15)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "world", ["room", "street", *(pytest.param(world, marks=pytest.mark.slow) for world in ("corridor_loop", "field"))]
)
def test_frames_are_within_the_range_of_real_ones(world: str, data_folder: Path) -> None:
    """Between the least and the largest value of both real sequences, but for the corridor's keypoints."""
    real = [spread(Tum.create(path=data_folder / name).open()) for name in ("fr3_office_715", "kitti00_half")]
    least, largest = np.min([low for low, _, _ in real], axis=0), np.max([high for _, _, high in real], axis=0)
    middle = spread(Synthetic.create(world=world, severity=0.5).open())[1]
    compared = slice(2) if world == "corridor_loop" else slice(3)
    assert (middle >= least)[compared].all(), (middle, least)
    assert (middle <= largest)[compared].all(), (middle, largest)
