"""Offers the SLAM backend `drift` to codecbench."""

from codecbench import PluginSpec, hookimpl


@hookimpl
def codecbench_slam_backends() -> list[PluginSpec]:
    return [PluginSpec("drift", "codecbench_drift.backend:Drift", "shifts between frames, added up")]
