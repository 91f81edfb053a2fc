"""Runs that there is something to show of."""

from __future__ import annotations

from pathlib import Path

from codecbench.core.contracts.errors import StoreError
from codecbench.core.results.collect import open_run
from codecbench.core.results.run_result import RunResult


def begun_run(folder: Path) -> RunResult:
    """The results in a run folder. Raises StoreError where it is no run folder, or no cell has a record yet."""
    run = open_run(folder)
    if not run.results:
        message = f"{folder} has no results yet: none of its {len(run.plan.cells)} cells has a record that can be read"
        raise StoreError(f"{message}; `codecbench run` computes them, `codecbench status {folder}` says how far it is")
    return run
