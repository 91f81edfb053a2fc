"""How often equal codecs are ordered and different ones are told: grids, padding, and a codec that loses nothing."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from simulated_tables import NOISES, RATES, SHARED, calibration, compared, curve, drifting, equal_codecs

from codecbench.core.analysis.curve_values import SMALLEST, CurveValues, difference
from codecbench.core.analysis.evidence import Evidence

FRAMES = 100


def is_told(evidence: Evidence) -> bool:
    return evidence.p_beyond(SMALLEST) < 0.01


def wobble(rng: np.random.Generator, settings: int) -> np.ndarray:
    return rng.normal(0.0, 1e-6, (settings, FRAMES))


@pytest.mark.thorough
def test_the_grid_of_settings_does_not_order_a_codec_and_itself(rng: np.random.Generator) -> None:
    """A hundred pairs of grids of two, four and eight settings each, evenly spread or at random."""
    told = 0
    for trial in range(300):
        scene = drifting(rng, (2, FRAMES), 0.9)
        grids = []
        for count in (rng.choice([2, 4, 8]), rng.choice([4, 8])):
            even = np.linspace(0, len(RATES) - 1, count).round().astype(int)
            grids.append(even if trial % 2 else np.sort(rng.choice(len(RATES), count, replace=False)))
        pair = [curve(grid, scene, wobble(rng, len(grid))) for grid in grids]
        found = difference(*pair)
        told += found is not None and is_told(compared(*pair))
    assert told <= 3


@pytest.mark.parametrize(("padding", "told", "equal"), [(0.001, 0, 10), (0.01, 0, 0), (0.05, 10, 0), (0.1, 10, 0)])
def test_padding_is_told_by_its_size(padding: float, told: int, equal: int, rng: np.random.Generator) -> None:
    """The same pictures, each frame with up to twice so much more bytes."""
    ordered, alike = 0, 0
    for _ in range(10):
        plain = curve(range(0, 12, 2), drifting(rng, (2, FRAMES), 0.9), wobble(rng, 6))
        padded = CurveValues(
            plain.points, plain.rates * (1 + 2 * padding * rng.random(plain.rates.shape)), plain.qualities, 0, "frames"
        )
        evidence = compared(plain, padded)
        ordered += is_told(evidence)
        alike += abs(evidence.mean) + evidence.reach(0.99) < SMALLEST
        assert np.expm1(evidence.mean) == pytest.approx(padding, rel=0.1)
    assert (ordered, alike) == (told, equal)


def test_a_codec_without_loss_at_the_same_rates_is_told(rng: np.random.Generator) -> None:
    lossy = curve(range(0, 12, 2), drifting(rng, (2, FRAMES), 0.9), wobble(rng, 6))
    cheat = CurveValues(lossy.points, lossy.rates, np.ones_like(lossy.qualities), 0, "frames")
    evidence = compared(cheat, lossy)
    assert evidence.mean > np.log(2.0)
    assert is_told(evidence)


def test_an_interval_is_that_of_its_two_codecs_whoever_else_was_run(rng: np.random.Generator) -> None:
    """Of six codecs at a rate and over all, each pair's evidence is the same as in a table of the two alone."""
    codecs = equal_codecs(rng, NOISES["correlation 0.5"][0], 80, 0.6, 6)
    for first, second in combinations(codecs, 2):
        alone = compared(CurveValues(**vars_of(first)), CurveValues(**vars_of(second)))
        assert alone == compared(first, second)
        assert alone.reach(0.95) < alone.reach(0.99), "each at its own level"


def vars_of(curve: CurveValues) -> dict[str, object]:
    return {name: getattr(curve, name) for name in ("points", "rates", "qualities", "missing", "of")}


@pytest.mark.thorough
@pytest.mark.parametrize("kind", NOISES)
@pytest.mark.parametrize("shared", SHARED)
def test_equal_codecs_are_seldom_ordered_and_intervals_cover(kind: str, shared: float) -> None:
    """100 tables of six codecs of six settings on 80 frames; docs/verdict.md has more."""
    ordered, covers, width = calibration(kind, 80, shared, 100)
    assert ordered <= (0.04 if kind in ("correlation 0.98", "three shots") else 0.02)
    assert covers > (0.85 if kind == "correlation 0.98" else 0.92)
    assert width > 0.9
