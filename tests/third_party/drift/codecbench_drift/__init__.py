"""Offers the SLAM backend `drift` to codecbench."""

from codecbench import Offer, hookimpl


@hookimpl
def codecbench_slam_backends() -> list[Offer]:
    return [Offer("drift", "codecbench_drift.backend:Drift", "shifts between frames, added up")]
