"""What two records of a cell have in common."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from kept_runs import write_kept_run
from told import numbers

from codecbench.core.analysis.verification import Values, compare_values, other_version, values_of
from codecbench.core.engine.planning.model import Cell
from codecbench.core.engine.storage.store import Store

KEY = ("error", "", 0, 0)


@pytest.fixture
def cell(tmp_path: Path) -> Cell:
    return write_kept_run(tmp_path / "run").cells[0]


def test_the_values_of_a_record(cell: Cell, tmp_path: Path) -> None:
    store = Store(tmp_path / "run")
    values = values_of(store, store.read_record(cell.id), {"error", "rate_bpp"})
    frames = {("error", "", frame, 0): frame + 0.25 for frame in range(3)}
    assert values == {("rate_bpp", "", None, 0): 1.5, **frames}


@pytest.mark.parametrize(
    ("there", "here", "verdict"),
    [
        (1.0, 1.0, "to the bit"), (math.nan, math.nan, "to the bit"), (math.inf, math.inf, "to the bit"),
        (0.0, -0.0, "to the bit"),
        (1.0, math.nextafter(1.0, 2.0), "within tolerance"), (-1e9, -1e9 - 500, "within tolerance"),
        (1.0, 1.0 + 2e-6, "differs"), (0.0, 1e-300, "differs"), (1.0, math.nan, "differs"),
        (math.inf, 1e300, "differs"), (math.inf, -math.inf, "differs"), (math.nan, 0.0, "differs"),
    ],
)  # fmt: skip
def test_a_value(cell: Cell, there: float, here: float, verdict: str) -> None:
    found = compare_values(cell, {KEY: there}, {KEY: here}, 1e-6, "numpy is older")
    assert (found.verdict, found.values) == (verdict, 1)
    assert (found.note == "") == (verdict == "to the bit")
    strict = compare_values(cell, {KEY: there}, {KEY: here}, 1e-6)
    assert strict.verdict == (verdict if verdict == "to the bit" else "differs")


def test_the_first_value_that_does_not_agree_is_named(cell: Cell) -> None:
    there: Values = {("error", "", frame, 0): 1.0 for frame in range(4)}
    here = {**there, ("error", "", 0, 0): 1.0 + 1e-9, ("error", "", 1, 0): 1.1, ("error", "", 2, 0): 1.5}
    found = compare_values(cell, there, here, 1e-6, "numpy is 1.0 there, 2.0 here")
    assert "1.1 here; 3 of 4" in found.note
    assert numbers(found.note) == [1.0, 1.0, 1.1, 3.0, 4.0, 1.0, 2.0]
    strict = compare_values(cell, there, here, 1e-6)
    assert "frame 0" in strict.note
    assert f"{1.0 + 1e-9!r} here; 3 of 4" in strict.note


def test_versions_that_may_change_a_result_are_compared() -> None:
    here = {
        "machine": {"architecture": "x86_64", "cpu": "one", "simd": ["avx", "avx2"]},
        "system": {"libc": "glibc 2.36", "release": "6.1"},
        "distributions": {"numpy": "2.0", "scipy": "1.15", "pandas": "2.2", "glymur": "0.14"},
        "libraries": {"opencv JPEG": "3.1"},
    }
    there = json.loads(json.dumps(here))
    there["machine"]["cpu"] = "another"
    there["distributions"] |= {"pandas": "2.3", "imagecodecs": "2026.3"}
    assert other_version(there, here) == ""
    there["distributions"]["scipy"] = "1.14"
    assert other_version(there, here) == "scipy is 1.14 there, 1.15 here"
    libc = other_version({**here, "system": {"libc": "glibc 2.41"}}, here)
    assert libc.startswith("libc is glibc 2.41")
    assert "glibc 2.36" in libc
    assert other_version({**here, "machine": {"architecture": "aarch64"}}, here).startswith("architecture is aarch64")
    newer = {"architecture": "x86_64", "simd": ["avx", "avx2", "avx512f"]}
    assert other_version({**here, "machine": newer}, here).startswith(f"simd is {newer['simd']}")
    assert other_version({"distributions": 7}, here) == "versions are unknown"


def test_values_that_only_one_side_has(cell: Cell) -> None:
    other = ("rate_bpp", "dc", None, 0)
    there = compare_values(cell, {KEY: 1.0, other: 2.0}, {KEY: 1.0}, 1e-6)
    here = compare_values(cell, {KEY: 1.0}, {KEY: 1.0, other: 2.0}, 1e-6)
    for found, said in ((there, "not measured"), (here, "here only")):
        assert found.note.startswith("rate_bpp/dc: ")
        assert said in found.note
    assert compare_values(cell, {}, {}, 1e-6).verdict == "not recomputed"
