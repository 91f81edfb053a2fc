"""Which cells are computed again."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from kept_runs import write_kept_run

from codecbench.core.analysis.verification import repeatable_metrics, sample_cells, verifiable_cells
from codecbench.core.engine.planning.model import Plan


@pytest.fixture
def plan(tmp_path: Path) -> Plan:
    return write_kept_run(tmp_path / "run", cells=6)


def test_metrics_that_come_out_the_same(plan: Plan) -> None:
    assert repeatable_metrics(plan, "judge") == {"rate_bpp", "error"}
    assert repeatable_metrics(plan, "nobody") is None


def test_cells_without_a_result_or_with_times_alone_are_not_sampled(plan: Plan) -> None:
    ids = [cell.id for cell in plan.cells]
    statuses = dict(zip(ids, ["ok", "failed", "ok", "unsupported", "ok"], strict=False))
    assert [cell.id for cell in verifiable_cells(plan, statuses)] == [ids[0], ids[2], ids[4]]
    (metric,) = [known for known in plan.declared["evaluators"]["judge"]["metrics"] if known["name"] == "ticks_ms"]
    only_times = replace(plan, declared={"evaluators": {"judge": {"metrics": [metric]}}})
    assert verifiable_cells(only_times, dict.fromkeys(ids, "ok")) == []


def test_equal_seeds_choose_equal_cells_and_every_cell_is_chosen_as_often(plan: Plan) -> None:
    cells = list(plan.cells)
    assert sample_cells(cells, 3, 7) == sample_cells(cells[::-1], 3, 7)[::-1]
    assert sample_cells(cells, 100, 7) == cells
    counts = Counter(cell.id for seed in range(600) for cell in sample_cells(cells, 3, seed))
    assert all(250 < counts[cell.id] < 350 for cell in cells)
