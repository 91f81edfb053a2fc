"""Executors that are none."""

from __future__ import annotations

from codecbench import NoParams


class Unexecuted:
    """No executor at all."""

    name, version, params_type = "unexecuted", "1", NoParams
