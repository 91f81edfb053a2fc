"""Commands begin at once: what takes long to import waits until something is computed with it."""

from __future__ import annotations

import subprocess
import sys

IMPORTED = """
import sys
import codecbench.core.results.answers, codecbench.core.results.comparison.compare
import codecbench.core.results.ranking.power
import codecbench.core.results.report.write, codecbench.core.results.running
print(*{"numba", "scipy", "matplotlib"} & sys.modules.keys())
"""


def test_neither_statistics_nor_the_compiler_are_imported_to_read_or_plan_a_run() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"
