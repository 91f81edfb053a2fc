"""Codecs without a curve of several qualities: lossless, saturated, constant, of one setting."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from codecbench.core.analysis.curve_values import CurveValues, difference

RATES = (0.25, 0.5, 1.0, 2.0)


def codec(qualities: list[float], rates: tuple[float, ...] = RATES, spread: float = 0.01) -> CurveValues:
    """40 frames at so many settings."""
    noise = spread * np.random.default_rng(len(qualities)).normal(size=(len(rates), 40))
    values = np.array(qualities)[:, None] + noise
    return CurveValues(tuple(map(str, rates)), np.repeat(np.array(rates)[:, None], 40, axis=1), values, 0, "frames")


CODECS = {
    "graded": codec([0.5, 0.6, 0.7, 0.8]),
    "lossless": codec([1.0], (3.0,), 0.0),
    "lossless at every setting": codec([1.0] * 4, spread=0.0),
    "saturated": codec([0.7, 0.9, 0.9, 0.9], spread=0.0),
    "constant": codec([0.6] * 4),
    "one setting": codec([0.65], (0.6,)),
    "twice the same rate": codec([0.5, 0.6], (0.6, 0.6)),
}


@pytest.mark.parametrize("at", [None, 0.25, 0.6, 2.0, 3.0])
def test_they_are_compared_or_not_without_an_error(at: float | None) -> None:
    for (first, a), (second, b) in combinations(CODECS.items(), 2):
        found = difference(a, b, at)
        turned = difference(b, a, at)
        assert (found is None) == (turned is None), (first, second)
        if found is not None and turned is not None:
            evidence = found.evidence("frames")
            assert np.isfinite(evidence.mean)
            assert 0.0 <= evidence.p_value <= 1.0
            assert turned.evidence("frames").mean == pytest.approx(-evidence.mean)


def test_what_is_better_at_no_more_rate_is_told() -> None:
    found = difference(CODECS["lossless at every setting"], CODECS["graded"])
    assert found is not None
    assert found.at_least
    assert found.mean == pytest.approx(np.log(8.0)), "the best of the other costs eight times the cheapest"
    assert found.evidence("frames").p_value < 0.01
    assert difference(CODECS["lossless"], CODECS["graded"]) is None, "it is better, and costs more"


def test_the_quality_at_a_rate_of_a_codec_that_has_but_one() -> None:
    assert CODECS["constant"].mean_at(0.6) == pytest.approx(0.6, abs=0.01)
    lossless = CODECS["lossless at every setting"]
    assert lossless.mean_at(0.6) == 1.0
    assert 0.7 < CODECS["saturated"].mean_at(0.3) < 0.9
    assert CODECS["saturated"].mean_at(1.5) == 0.9


def test_curves_that_share_less_than_a_quarter_of_their_qualities_have_no_interval() -> None:
    """The same codec at other rates is not compared; a codec that is better where both spend as much is ahead."""
    coarse, fine = codec([0.5, 0.6, 0.7, 0.8]), codec([0.78, 0.9, 1.0], (1.9, 4.0, 8.0))
    assert difference(coarse, fine) is None
    better = difference(codec([0.85, 0.9, 1.0], (1.9, 4.0, 8.0)), coarse)
    assert better is not None
    assert better.evidence("frames").reach(0.95) == np.inf
