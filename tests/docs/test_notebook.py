"""The notebook in examples/ runs, cell by cell, in a folder of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from project import ROOT

NOTEBOOK = ROOT / "examples" / "first_steps.ipynb"


def test_it_is_kept_without_results() -> None:
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    assert [cell.get("outputs", []) for cell in cells] == [[] for _ in cells]


@pytest.mark.thorough
def test_its_cells_run(tmp_path: Path) -> None:
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    program = "\n\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    checks = "assert run.failed == [] and coded.decoded.shape == picture.shape"
    done = subprocess.run(
        [sys.executable, "-c", f"{program}\n{checks}"], cwd=tmp_path, capture_output=True, text=True, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "runs" / "notebook" / "report" / "report.html").stat().st_size > 10_000
