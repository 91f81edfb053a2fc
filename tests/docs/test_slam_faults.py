"""The courses of tests/benchmarks/slam_faults.py are what its tables say, and one of them runs."""

from __future__ import annotations

import re
import sys
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from project import TESTS

from codecbench.plugins.datasets.synthetic.dataset import Synthetic

sys.path.insert(0, str(TESTS / "benchmarks"))
import slam_faults
from slam_faults import Film, blackened, course, faults, in_two_parts


def fault(found: dict[str, list[Any]], words: str) -> list[Any]:
    """The one course whose title has these words."""
    (course,) = (course for title, course in found.items() if words in title)
    return course


def test_faults_are_what_they_are_called() -> None:
    frames = course(list(range(100, 700)))
    found = dict(faults(frames))
    assert found["none"] == frames
    for share, words in ((0.1, "10 % of"), (0.3, "30 % missing")):
        assert abs(len(fault(found, words)) - (1 - share) * 600) < 4 * np.sqrt(600 * share * (1 - share))
    assert len(fault(found, "0.5 s missing")) == 600 - 3 * 15
    black = [place for place, frame in enumerate(fault(found, "2 s black")) if frame.black]
    assert black == [*range(180, 240), *range(330, 390), *range(480, 540)]
    repeated = fault(found, "20 % are")
    assert 60 < sum(a.index == b.index for a, b in zip(repeated[1:], repeated, strict=False)) < 180
    late = [b.time_s - a.time_s for a, b in zip(frames, fault(found, "late by up to 0.9"), strict=True)]
    assert 0 <= min(late) < max(late) < 0.9 / 30
    gains = [frame.gain for frame in fault(found, "0.6, 1, 1.5, 0.8, 1.3")]
    assert gains[:151:30] == [0.6, 1.0, 1.5, 0.8, 1.3, 0.6]
    slow = course(list(range(600)), 10.0)
    assert len(fault(dict(faults(slow)), "0.5 s missing")) == 600 - 3 * 5
    for shown in found.values():
        assert all(a.time_s < b.time_s for a, b in pairwise(shown))


def test_two_parts_are_shown_with_black_frames_between_them() -> None:
    black, without = in_two_parts(range(5, 8), range(2), 4)
    assert [(frame.index, frame.black) for frame in black] == [
        *((index, False) for index in (5, 6, 7)), *[(7, True)] * 4, *((index, False) for index in (0, 1)),
    ]  # fmt: skip
    assert [frame.index for frame in without] == [5, 6, 7, 0, 1]


def test_the_truth_is_where_the_camera_was_when_it_took_what_is_shown() -> None:
    film = Film(Synthetic.create(stop=10, width=96, height=72).open())
    assert film.rate_hz == 30.0
    truth = film.sequence.ground_truth
    assert truth is not None
    shown = film.truth(blackened(course([9, 3, 3, 0]), 1, 1))
    np.testing.assert_array_equal(shown.timestamps_s, [0.0, 2 / 30, 3 / 30])
    np.testing.assert_array_equal(shown.positions_world, truth.positions_world[[9, 3, 0]])


@pytest.mark.thorough
def test_a_row_of_each_table_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    film = Film(Synthetic.create(stop=120, width=320, height=240).open())
    whole = course(list(range(len(film))))
    without = film.outcome(whole)
    row = slam_faults.gap_row("room", "100-119", film.outcome(blackened(whole, 100, 119)), without)
    assert len(row) == len(slam_faults.GAPS)
    assert "first map" in str(row[2])
    assert row[3] == "1, 0"
    assert float(str(row[4])) > 90
    assert float(str(row[5])) < 20
    monkeypatch.setattr(slam_faults, "faults", lambda frames: [("none", frames[:80])])
    ((title, cell),) = slam_faults.fault_rows([film])
    assert title == "none"
    tracked, error = re.fullmatch(r"([\d.]+) %, ([\d.]+) mm", str(cell)).groups()  # type: ignore[union-attr]
    assert float(tracked) > 90
    assert float(error) < 20
