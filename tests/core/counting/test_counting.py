"""The counting build against the interpreter: the same counts, the same results, on every run."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import instrument_kernels as examples
import numpy as np
import pytest
from opcode_oracle import Oracle

from codecbench.core.counting.kernel import Kernel, new_counters
from codecbench.core.counting.operations import CLASSES, OperationCounts
from codecbench.core.counting.trace import NULL_TRACE, CountingTrace


def cases(seed: int) -> list[tuple[Kernel, tuple[Any, ...]]]:
    rng = np.random.default_rng(seed)
    integers = rng.integers(0, 9, 12)
    return [
        (examples.arithmetic, (rng.random(7), rng.random(7))),
        (examples.conditions, (integers, rng.integers(0, 2, 12))),
        (examples.loops, (integers, 11)),
        (examples.indices, (rng.integers(0, 50, (5, 7)), rng.permutation(5), np.ones((5, 7), np.int64))),
        (examples.calls, (rng.integers(0, 30, 6), rng.random(6) * 9)),
        (examples.nested_choices, (rng.integers(0, 6, 9),)),
        (examples.nothing, (rng.integers(-1, 9, 9),)),
        (examples.recursive, (7,)),
        (examples.loose_values, (integers,)),
    ]


NAMES = [kernel.python.__name__ for kernel, _ in cases(0)]


def flat(result: Any) -> Any:
    parts = result if isinstance(result, tuple) else (result,)
    return np.concatenate([np.ravel(0.0 if part is None else part) for part in parts])


def counted(kernel: Kernel, arguments: tuple[Any, ...]) -> tuple[Any, list[int], tuple[Any, ...]]:
    counters, own = new_counters(), deepcopy(arguments)
    return kernel.counting_build(counters, *own), counters.tolist(), own


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("case", range(len(NAMES)), ids=NAMES)
def test_counts_equal_those_of_the_interpreter(case: int, seed: int) -> None:
    kernel, arguments = cases(seed)[case]
    oracle = Oracle()
    expected = oracle.run(kernel, *deepcopy(arguments))
    result, counters, _ = counted(kernel, arguments)
    assert counters == oracle.counters
    np.testing.assert_allclose(flat(result), flat(expected), rtol=1e-12)


@pytest.mark.parametrize("case", range(len(NAMES)), ids=NAMES)
def test_both_builds_give_the_same_bits_and_every_run_the_same_counts(case: int) -> None:
    kernel, arguments = cases(3)[case]
    own = deepcopy(arguments)
    result = kernel(*own)
    again, counters, changed = counted(kernel, arguments)
    assert repr(result) == repr(again)
    for ours, theirs in zip(own, changed, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert counted(kernel, arguments)[1] == counters


def test_the_examples_use_every_class() -> None:
    counts = np.sum([counted(kernel, arguments)[1] for kernel, arguments in cases(0)], axis=0)
    assert (counts > 0).all()


def test_a_count_by_hand() -> None:
    _, counters, _ = counted(examples.divided, (17, 5))
    assert OperationCounts.from_counters(np.array(counters)) == OperationCounts(mults=2, adds=1, divisions=1)


def test_stages_add_up_and_keep_their_own() -> None:
    trace = CountingTrace()
    with trace.stage("outer") as run:
        run(examples.clamped, 5, 0, 3)
        with trace.stage("inner") as run_inner:
            assert run_inner(examples.divided, 7, 2) == (3, 1)
        run(examples.clamped, -5, 0, 3)
    with trace.stage("outer") as run:
        run(examples.clamped, 1, 0, 3)
    with trace.stage("idle"):
        pass
    assert trace.counts == {
        "outer": OperationCounts(comparisons=2 + 1 + 2),
        "inner": OperationCounts(mults=2, adds=1, divisions=1),
        "idle": OperationCounts(),
    }
    assert list(trace.counts) == ["outer", "inner", "idle"]


def test_the_null_trace_runs_anything() -> None:
    with NULL_TRACE.stage("dct") as run:
        assert run(examples.clamped, 9, 0, 3) == 3
        assert run(max, 1, 2) == 2


def test_a_counting_trace_refuses_what_is_no_kernel() -> None:
    with CountingTrace().stage("dct") as run, pytest.raises(TypeError, match=r"'dct'.*only a @kernel"):
        run(max, 1, 2)


def test_totals_leave_out_divisions_and_indices() -> None:
    counts = OperationCounts(*range(1, 10))
    assert counts.total == sum(range(1, 8))
    assert len(CLASSES) == 7
    assert counts + counts == OperationCounts(*range(2, 20, 2))
