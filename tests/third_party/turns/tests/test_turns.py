import numpy as np
import pytest
from codecbench_turns.link import Turns

from codecbench.core.conformance.links import check_link


def test_it_keeps_the_contract() -> None:
    check_link(Turns.create(loss=0.1))


def test_what_does_not_fit_into_a_turn_goes_on_in_the_next() -> None:
    channel = Turns.create(rate_kbps=80, period_ms=100, share=0.5).open(np.random.default_rng(0))
    assert channel.carry(100, 0.0).sent_s == pytest.approx(0.010)
    assert channel.carry(500, 0.010).sent_s == pytest.approx(0.110)
    assert channel.carry(100, 0.160).sent_s == pytest.approx(0.210)
