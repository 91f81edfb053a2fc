"""The same bytes and the same pixels, however the kernels are compiled."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from coded_elsewhere import digests

SUPPORT = Path(__file__).parents[3] / "support"
HARDLY_OPTIMISED_AND_GENERIC = {"NUMBA_OPT": "1", "NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}
"""Also for a processor without fused multiply-add, and without wide vectors."""


@pytest.mark.thorough
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("arithmetic", "settings"),
    [("fastmath", {"NUMBA_OPT": "3"}), ("exact", HARDLY_OPTIMISED_AND_GENERIC)],
    ids=["fastmath", "hardly-optimised-on-a-generic-processor"],
)
def test_compilers_and_processors_do_not_matter(arithmetic: str, settings: dict[str, str], tmp_path: Path) -> None:
    environment = {**os.environ, **settings, "CODECBENCH_CACHE": str(tmp_path)}
    environment["PYTHONPATH"] = os.pathsep.join([str(SUPPORT), environment.get("PYTHONPATH", "")])
    command = [sys.executable, str(SUPPORT / "coded_elsewhere.py"), arithmetic]
    elsewhere = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
    assert elsewhere.stdout == digests()
