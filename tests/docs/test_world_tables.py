"""What docs/worlds.md says of the worlds, and that their frames are like those of real cameras."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from project import DOCS

from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.synthetic.worlds.conditions import moved
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLDS
from codecbench.plugins.datasets.tum import Tum

sys.path.insert(0, str(DOCS))
import world_tables

PAGE = (DOCS / "worlds.md").read_text()


def test_the_page_shows_what_severity_moves_today() -> None:
    for row in world_tables.conditions():
        assert row in PAGE, "run docs/world_tables.py conditions and docs/tables.py"
    for world in WORLDS.values():
        for name in moved(world.calm, world.hard):
            assert f"| `{name}` |" in PAGE, f"{name} is not explained"


def test_the_contact_sheet_is_there_and_small() -> None:
    sheet = cv2.imread(str(world_tables.SHEET))
    assert sheet.shape[0] >= (len(WORLDS) + 1) // 2 * 100
    assert world_tables.SHEET.stat().st_size < 300_000


def test_the_slope_of_a_spectrum_is_that_of_noise_made_with_it() -> None:
    rng = np.random.default_rng(1)
    frequencies = np.fft.fftfreq(256)
    radius = np.hypot(frequencies[:, None], frequencies)
    radius[0, 0] = 1.0
    for exponent in (2.0, 3.0):
        spectrum = np.fft.fft2(rng.standard_normal((256, 256))) / radius ** (exponent / 2)
        gray = np.fft.ifft2(spectrum).real
        gray = np.clip(128 + 30 * gray / gray.std(), 0, 255).astype(np.uint8)
        assert world_tables.spectrum_slope(gray) == pytest.approx(-exponent, abs=0.15)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "world", ["room", "street", *(pytest.param(world, marks=pytest.mark.slow) for world in ("corridor_loop", "field"))]
)
def test_frames_are_within_the_range_of_real_ones(world: str, data_folder: Path) -> None:
    """Between the least and the largest value of both real sequences, but for the corridor's keypoints."""
    real = [world_tables.spread(Tum.create(path=data_folder / name).open()) for name in world_tables.REAL]
    least, largest = np.min([low for low, _, _ in real], axis=0), np.max([high for _, _, high in real], axis=0)
    middle = world_tables.spread(Synthetic.create(world=world, severity=0.5).open())[1]
    compared = slice(2) if world == "corridor_loop" else slice(3)
    assert (middle >= least)[compared].all(), (middle, least)
    assert (middle <= largest)[compared].all(), (middle, largest)
