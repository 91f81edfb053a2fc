"""What vector registers buy in the Schur complement: an adjustment with them, and with the same sums in plain numba.

pytest tests/benchmarks/test_slam_vector_kernels.py
"""

from __future__ import annotations

from types import FunctionType
from typing import Any

import numba
import numpy as np
import pytest
from solver_scenes import corridor, disturbed

from codecbench.slam.optimization import bundle_adjustment, bundle_kernels, bundle_schur

SIZES = {"local": (20, 2_000, 8_000), "loop": (150, 15_000, 90_000)}


@numba.njit
def plain_subtract_product(system, start, stride, product, crosses, row):  # type: ignore[no-untyped-def]
    for a in range(6):
        p0, p1, p2 = product[a, 0], product[a, 1], product[a, 2]
        for b in range(6):
            total = crosses[row, 0, b] * p0 + crosses[row, 1, b] * p1 + crosses[row, 2, b] * p2
            system[start + a * stride + b] -= total


def rebuilt(kernel: Any, **globals_: Any) -> Any:
    """A kernel compiled anew, with some of the functions that it calls exchanged."""
    function = kernel.py_func
    return numba.njit(FunctionType(function.__code__, {**function.__globals__, **globals_}, function.__name__))


def plain_minimize() -> Any:
    point = rebuilt(bundle_schur._eliminate_point, subtract_product=plain_subtract_product)
    eliminate = rebuilt(bundle_schur.eliminate, _eliminate_point=point)
    return rebuilt(bundle_kernels.minimize, eliminate=eliminate)


@pytest.fixture(scope="module")
def builds() -> dict[str, Any]:
    return {"vectors": bundle_kernels.minimize, "plain": plain_minimize()}


@pytest.mark.parametrize("build", ["vectors", "plain"])
@pytest.mark.parametrize("size", SIZES)
def test_adjustment(
    benchmark: Any, builds: dict[str, Any], size: str, build: str, rng: np.random.Generator, monkeypatch: Any
) -> None:
    monkeypatch.setattr(bundle_adjustment, "minimize", builds[build])
    scene = disturbed(corridor(rng, *SIZES[size], noise_px=0.7), rng, 0.01, 0.003, 0.03)
    found = benchmark.pedantic(bundle_adjustment.adjust, scene.arguments(), rounds=9, warmup_rounds=1)
    benchmark.extra_info["iterations"] = found.iterations
    assert found.cost_after < 0.1 * found.cost_before
