"""How often equal codecs are ordered and different ones are told: grids, padding, and a codec that loses nothing."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.signal import lfilter

from codecbench.core.analysis.curve_values import SMALLEST, CurveValues, difference
from codecbench.core.analysis.evidence import Evidence, evidence_of_pairs
from codecbench.core.analysis.ranking import holm

FRAMES = 100
RATES = np.geomspace(0.1, 1.6, 12)


def drifting(rng: np.random.Generator, series: int, count: int, correlation: float) -> np.ndarray:
    """(series, count) values of variance 1 of which neighbours are correlated."""
    steps = rng.normal(size=(series, count + 400)) * np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], steps, axis=1)[:, 400:])


def curve(rng: np.random.Generator, places: Sequence[int], scene: np.ndarray, factor: float = 1.0) -> CurveValues:
    """Settings of a codec whose quality saturates with the rate, on frames that are harder or easier for all."""
    rates = factor * RATES[list(places), None] * np.exp(0.2 * scene[0])
    qualities = 0.9 - 0.6 * np.exp(-3.0 * RATES[list(places), None]) + 0.05 * scene[1]
    return CurveValues(tuple(map(str, places)), rates, qualities + rng.normal(0.0, 1e-6, rates.shape), 0, "frames")


def compared(first: CurveValues, second: CurveValues) -> Evidence:
    found = difference(first, second)
    assert found is not None
    (evidence,) = evidence_of_pairs(found.changes[None], 1, "frames", 0.01)
    return Evidence(evidence.mean, evidence.variance, evidence.freedom, found.doubt)


def is_told(evidence: Evidence) -> bool:
    return evidence.p_beyond(SMALLEST) < 0.01


@pytest.mark.thorough
def test_the_grid_of_settings_does_not_order_a_codec_and_itself(rng: np.random.Generator) -> None:
    """A hundred pairs of grids of two, four and eight settings each, evenly spread or at random."""
    told = 0
    for trial in range(300):
        scene = drifting(rng, 2, FRAMES, 0.9)
        grids = []
        for count in (rng.choice([2, 4, 8]), rng.choice([4, 8])):
            even = np.linspace(0, len(RATES) - 1, count).round().astype(int)
            grids.append(even if trial % 2 else np.sort(rng.choice(len(RATES), count, replace=False)))
        pair = [curve(rng, grid, scene) for grid in grids]
        found = difference(*pair)
        told += found is not None and is_told(compared(*pair))
    assert told <= 3


@pytest.mark.parametrize(("padding", "told", "equal"), [(0.001, 0, 10), (0.01, 0, 0), (0.05, 10, 0), (0.1, 10, 0)])
def test_padding_is_told_by_its_size(padding: float, told: int, equal: int, rng: np.random.Generator) -> None:
    """The same pictures, each frame with up to twice so much more bytes."""
    ordered, alike = 0, 0
    for _ in range(10):
        plain = curve(rng, range(0, 12, 2), drifting(rng, 2, FRAMES, 0.9))
        padded = CurveValues(
            plain.points, plain.rates * (1 + 2 * padding * rng.random(plain.rates.shape)), plain.qualities, 0, "frames"
        )
        evidence = compared(plain, padded)
        ordered += is_told(evidence)
        alike += abs(evidence.mean) + evidence.reach(0.99) < SMALLEST
        assert np.expm1(evidence.mean) == pytest.approx(padding, rel=0.1)
    assert (ordered, alike) == (told, equal)


def test_a_codec_without_loss_at_the_same_rates_is_told(rng: np.random.Generator) -> None:
    scene = drifting(rng, 2, FRAMES, 0.9)
    lossy = curve(rng, range(0, 12, 2), scene)
    cheat = CurveValues(lossy.points, lossy.rates, np.ones_like(lossy.qualities), 0, "frames")
    evidence = compared(cheat, lossy)
    assert evidence.mean > np.log(2.0)
    assert is_told(evidence)


@pytest.mark.thorough
@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.8, 0.9, 0.95, 0.98])
@pytest.mark.parametrize("codecs", [2, 6])
def test_equal_codecs_are_ordered_in_at_most_one_table_of_a_hundred(correlation: float, codecs: int) -> None:
    """400 tables of 100 frames each, with and without independent noise of each frame."""
    rng = np.random.default_rng(1)
    first, second = np.triu_indices(codecs, 1)
    ordered = 0
    for trial in range(400):
        values = drifting(rng, codecs, FRAMES, correlation) + (trial % 2) * rng.normal(size=(codecs, FRAMES))
        values *= rng.uniform(0.5, 2.0, codecs)[:, None]
        evidence = evidence_of_pairs(values[first] - values[second], codecs - 1, "frames", 0.01 / len(first))
        ordered += bool((holm(np.array([each.p_value for each in evidence])) < 0.01).any())
    assert ordered <= 8, "two in a hundred: the count itself is known to about a half"
