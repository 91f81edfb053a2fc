"""Lets the tests of the example distributions import them, as if they were installed."""

from __future__ import annotations

import sys
from pathlib import Path

for _distribution in Path(__file__).parent.iterdir():
    if (_distribution / "pyproject.toml").exists():
        sys.path.insert(0, str(_distribution))
