"""What a coder starts from fits the coder, and helps."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.plugins.codecs.multilevel.context import profile
from codecbench.plugins.codecs.multilevel.context.binary import MAX_SEEN
from codecbench.plugins.codecs.multilevel.context.contexts import CONTEXTS, WEIGHT_SETS, new_statistics


@pytest.mark.parametrize("chroma", [False, True])
def test_priors_fit_the_model(chroma: bool) -> None:
    model, weights = new_statistics(chroma)
    assert model.shape == (CONTEXTS,)
    assert weights.shape == (WEIGHT_SETS, 3)
    assert (model >> 8).min() > 0
    assert (model >> 8).max() < 1 << 22
    assert (model & 255).max() <= MAX_SEEN
    assert 0.3 < weights.mean() / 65536 < 0.5


def test_statistics_are_new_each_time() -> None:
    model, weights = new_statistics(False)
    model[:], weights[:] = 0, 0
    assert new_statistics(False)[0].any()
    assert new_statistics(False)[1].any()


def test_luma_and_chroma_differ() -> None:
    assert not np.array_equal(new_statistics(False)[0], new_statistics(True)[0])


def test_priors_are_what_the_profile_codes_with() -> None:
    assert profile.new_statistics is new_statistics
