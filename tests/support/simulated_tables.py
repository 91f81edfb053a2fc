"""Tables of equal codecs. `python tests/support/simulated_tables.py` writes the calibration of docs/verdict.md."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
from scipy.signal import lfilter

from codecbench.core.analysis.curve_values import CurveValues, difference
from codecbench.core.analysis.evidence import Evidence
from codecbench.core.analysis.ranking import holm

RATES = np.geomspace(0.1, 1.6, 12)
SHARED = (0.2, 1.0)
"""Shares of the variance of its noise that all settings of a codec have in common."""

Noise = Callable[[np.random.Generator, tuple[int, ...]], np.ndarray]


def drifting(rng: np.random.Generator, shape: tuple[int, ...], correlation: float) -> np.ndarray:
    """Values of variance 1 of which neighbors along the last axis are correlated."""
    steps = rng.normal(size=(*shape[:-1], shape[-1] + 400)) * np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], steps, axis=-1)[..., 400:])


def in_shots(rng: np.random.Generator, shape: tuple[int, ...], size: float) -> np.ndarray:
    """Independent values with an offset of so many standard deviations in each of three shots."""
    lengths = np.diff(np.linspace(0, shape[-1], 4).astype(int))
    return rng.normal(size=shape) + np.repeat(size * rng.normal(size=(*shape[:-1], 3)), lengths, axis=-1)


def heavy(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Values of Student's t with three degrees of freedom, in bursts that all codecs share."""
    return np.asarray(rng.standard_t(3, size=shape) * np.exp(drifting(rng, shape[-1:], 0.9)))


NOISES: dict[str, list[Noise]] = {
    **{
        f"correlation {rho}": [
            lambda rng, shape, rho=rho: drifting(rng, shape, rho),
            lambda rng, shape, rho=rho: drifting(rng, shape, rho) + rng.normal(size=shape),
        ]
        for rho in (0.0, 0.5, 0.9, 0.98)
    },
    "three shots": [lambda rng, shape, size=size: in_shots(rng, shape, size) for size in (0.5, 1.0, 2.0)],
    "heavy tails, bursts": [heavy],
}  # type: ignore[misc]  # mypy infers no lambda with a default


def curve(places: Sequence[int], scene: np.ndarray, noise: np.ndarray | float, factor: float = 1.0) -> CurveValues:
    """Settings of a codec whose quality saturates with the rate, on frames that are harder or easier for all.

    scene: (2, N) of rates and of qualities. noise: (S, N), of qualities.
    """
    rates = factor * RATES[list(places), None] * np.exp(0.2 * scene[0])
    qualities = 0.9 - 0.6 * np.exp(-3.0 * RATES[list(places), None]) + 0.05 * scene[1] + noise
    return CurveValues(tuple(map(str, places)), rates, qualities, 0, "frames")


def compared(first: CurveValues, second: CurveValues) -> Evidence:
    """What is known of two curves."""
    found = difference(first, second)
    assert found is not None
    return found.evidence("frames")


def equal_codecs(rng: np.random.Generator, noise: Noise, frames: int, shared: float, codecs: int) -> list[CurveValues]:
    """Codecs with six settings at the same rates, which differ by noise alone."""
    scene = drifting(rng, (2, frames), 0.9)
    of_codecs, of_settings = noise(rng, (codecs, 1, frames)), noise(rng, (codecs, 6, frames))
    values = 0.02 * (np.sqrt(shared) * of_codecs + np.sqrt(1.0 - shared) * of_settings)
    return [curve(range(0, 12, 2), scene, of_codec) for of_codec in values]


def calibration(kind: str, frames: int, shared: float, tables: int) -> tuple[float, float, float]:
    """Shares of tables that order two of six equal codecs, and of 95 % intervals that cover 0; their median half width
    over 1.96 standard deviations of the differences."""
    rng = np.random.default_rng(1)
    ordered, covers, widths = 0, [], []
    for noise in NOISES[kind]:
        means, halves = [], []
        for _ in range(-(-tables // len(NOISES[kind]))):
            pairs = [compared(*pair) for pair in combinations(equal_codecs(rng, noise, frames, shared, 6), 2)]
            ordered += bool((holm(np.array([replace(each, doubt=0.0).p_value for each in pairs])) < 0.01).any())
            means += [each.mean for each in pairs]
            halves += [each.reach(0.95) - each.doubt for each in pairs]
        covers.append(np.mean(np.abs(means) <= halves))
        widths.append(np.median(halves) / (1.96 * np.std(means)))
    return ordered * 15 / (len(NOISES[kind]) * len(means)), float(np.mean(covers)), float(np.mean(widths))


def row(kind: str, frames: int, tables: int) -> str:
    """A row of the table."""
    found = [calibration(kind, frames, shared, tables) for shared in SHARED]
    cells = (f"{100 * ordered:.1f} % | {100 * covers:.0f} % | {width:.2f}" for ordered, covers, width in found)
    return f"| {kind} | {frames} | {' | '.join(cells)} |"


if __name__ == "__main__":
    tables = int(sys.argv[1]) if len(sys.argv) > 1 else 800
    say = partial(print, flush=True)
    heads = ("ordered", "covers", "width", "ordered, alike", "covers, alike", "width, alike")
    say(f"| noise of a codec's values | frames | {' | '.join(heads)} |")
    say("|---|---:|---:|---:|---:|---:|---:|---:|")
    with ProcessPoolExecutor() as workers:
        cells = [(kind, frames) for kind in NOISES for frames in (80, 700)]
        for made in [workers.submit(row, *cell, tables) for cell in cells]:
            say(made.result())
