"""What tests/benchmarks/slam_frames.py prints, on known answers."""

from __future__ import annotations

import importlib.util
import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from codecbench.slam.map.map import Map

SCRIPT = Path(__file__).parents[1] / "benchmarks" / "slam_frames.py"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("slam_frames", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def test_a_step_is_timed_without_the_steps_that_it_calls(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    now_ns = iter([0, 10, 40, 100])  # the outer step begins, the inner one begins and ends, the outer one ends
    monkeypatch.setattr(time, "process_time_ns", lambda: next(now_ns))
    steps = SimpleNamespace(inner=lambda: 7)
    steps.outer = lambda: steps.inner() + 1
    monkeypatch.setattr(script, "STEPS", {"one": ((steps, "inner"),), "two": ((steps, "outer"),)})
    timer = script.StepTimer()
    timer.watch()
    assert steps.outer() == 8
    assert timer.spent_ns == {"one": 30, "two": 70}


def test_every_step_names_what_there_is(script: ModuleType) -> None:
    for functions in script.STEPS.values():
        for owner, name in functions:
            assert callable(getattr(owner, name))


def test_arrays_are_counted_once_with_what_they_are_views_of(script: ModuleType) -> None:
    array = np.zeros((10, 4))
    assert script.array_bytes([array, array[2:5], {"again": array}, (np.zeros(3, np.uint8), "text", 5)]) == 323
    slam_map = Map(0, 1.2 ** np.arange(8), np.ones(8), 500)
    before = script.array_bytes(slam_map)
    slam_map.points.add(np.zeros((5000, 3)), 0, 0)  # more than the table holds: it doubles
    row = 3 * 8 + 3 * 8 + 8 + 8 + 4 * 8 + 1 + 7 * 8
    assert script.array_bytes(slam_map) - before == 4096 * row
