"""Commands begin at once: what takes long to import waits until something is computed with it."""

from __future__ import annotations

import ast
import subprocess
import sys
from graphlib import TopologicalSorter
from pathlib import Path

import codecbench

IMPORTED = """
import sys
import codecbench.core.report.answers, codecbench.core.analysis.comparison
import codecbench.core.analysis.power
import codecbench.core.report.page, codecbench.core.rounds.running
print(*{"numba", "scipy.special", "scipy.stats", "scipy.optimize", "matplotlib"} & sys.modules.keys())
"""


def test_neither_statistics_nor_the_compiler_are_imported_to_read_or_plan_a_run() -> None:
    done = subprocess.run([sys.executable, "-c", IMPORTED], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def imports_of(path: Path) -> set[str]:
    """The modules that a file imports anywhere: in functions and for type checkers too."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names} | {node.module}
    return names


def test_no_module_imports_itself_by_way_of_others() -> None:
    root = Path(codecbench.__file__).parent
    modules = {".".join(path.relative_to(root.parent).with_suffix("").parts): path for path in root.rglob("*.py")}
    graph = {name: (imports_of(path) & modules.keys()) - {name} for name, path in modules.items()}
    assert len(graph["codecbench.core.facade"]) > 10
    TopologicalSorter(graph).prepare()  # raises CycleError, which names the modules of a circle
