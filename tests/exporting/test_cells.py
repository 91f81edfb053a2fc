"""Which cell's trajectory is exported."""

from __future__ import annotations

import pytest
from measured_runs import cell_result

from codecbench.core.contracts.errors import SlamError
from codecbench.exporting.cells import slam_result


def test_the_cell_is_that_of_the_evaluator_and_repeat() -> None:
    quality = cell_result("jpeg", 1, "quality")
    slam = [cell_result("jpeg", 1, "trajectory", repeat=repeat) for repeat in (0, 1)]
    lost = cell_result("jpeg", 1, "trajectory", repeat=2, status="failed", reason="ValueError: it fails")
    results = (quality, *slam, lost)
    assert slam_result(results, None, 0) is slam[0]
    assert slam_result(results, "trajectory", 1) is slam[1]
    for given, title, repeat, said in (
        ((quality,), None, 0, "add `trajectory`"),
        (results, "trajectory(backend=orb)", 0, r"trajectory\(backend=orb\); it has trajectory$"),
        (results, None, 5, "no repeat 5; it has 0, 1, 2"),
        (results, None, 2, "repeat 2: failed, ValueError: it fails"),
    ):
        with pytest.raises(SlamError, match=said):
            slam_result(given, title, repeat)
