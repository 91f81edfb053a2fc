"""Where codecbench keeps what can be made or fetched again."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs


def cache_folder() -> Path:
    """The folder for what can be made again: `$CODECBENCH_CACHE`, else the platform's own place."""
    named = os.environ.get("CODECBENCH_CACHE")
    return Path(named).expanduser() if named else Path(platformdirs.user_cache_dir("codecbench"))
