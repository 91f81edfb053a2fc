"""The checks of links find those that break the contract."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from codecbench import Channel, Link, Passage
from codecbench.core.conformance.links import check_link
from codecbench.plugins.links.constant import Ideal


class Hasty(Ideal):
    """Packets arrive before they are sent."""

    name = "hasty"

    def open(self, rng: np.random.Generator) -> Channel:
        class Back(Channel):
            def carry(self, size_bytes: int, start_s: float) -> Passage:
                return Passage(start_s, start_s - 0.001)

        return Back()


class Moody(Ideal):
    """Another answer every time."""

    name = "moody"
    keeps_order = False
    count = 0.0

    def open(self, rng: np.random.Generator) -> Channel:
        class Mood(Channel):
            def carry(self, size_bytes: int, start_s: float) -> Passage:
                Moody.count += 1.0
                return Passage(start_s, start_s + Moody.count)

        return Mood()


class Shuffling(Ideal):
    """Says that it keeps the order, and does not."""

    name = "shuffling"

    def open(self, rng: np.random.Generator) -> Channel:
        class Shuffle(Channel):
            def carry(self, size_bytes: int, start_s: float) -> Passage:
                return Passage(start_s, start_s + rng.random())

        return Shuffle()


@pytest.mark.parametrize(
    ("link", "words"),
    [(Hasty, "plus the delay"), (Moody, "other passages"), (Shuffling, "or later")],
)
def test_a_link_that_breaks_the_contract_is_found(link: type[Link[Any]], words: str) -> None:
    with pytest.raises(AssertionError, match=words):
        check_link(link.create())
