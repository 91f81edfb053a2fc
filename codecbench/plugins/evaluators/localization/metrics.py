"""The metrics of the `localization` evaluator. docs/metrics.md defines each."""

from __future__ import annotations

from typing import Final

from codecbench.core.contracts.metric import Metric

WAYS: Final = {"tracked": "from the previous pose", "relocalized": "from nothing"}
"""The two ways in which a frame is located, by the prefix of their metrics."""


def _of(way: str, how: str) -> tuple[Metric, ...]:
    def task(name: str, unit: str, summary: str, label: str) -> Metric:
        spread, summary, label = ("median", "p95"), f"{summary}, {how}", f"{label}, {how}"
        return Metric(f"{way}_{name}", unit, "lower", summary, spread, role="task", label=label, scale="log")

    return (
        Metric(
            f"{way}_located", "1", "higher", f"1 if located {how}, else 0",
            role="task", label=f"located {how}",
        ),
        Metric(
            f"{way}_inliers", "1", "higher", f"map points behind a right pose, else 0, {how}",
            role="task", headline=way == "tracked", label=f"map points found, {how}", column_header="map points",
        ),
        task("position_error_mm", "mm", "distance from the true position", "position error"),
        task("rotation_error_deg", "deg", "angle from the true orientation", "rotation error"),
        task("position_to_raw_mm", "mm", "distance from the raw frame's position", "position beside raw"),
        task("rotation_to_raw_deg", "deg", "angle from the raw frame's orientation", "rotation beside raw"),
    )  # fmt: skip


METRICS: Final = (
    Metric(
        "located_auc", "1", "higher",
        "max(0, 1 - d / L), d the distance from the raw frame's position",
        role="task", headline=True, label="localisation AUC", column_header="located", enough=0.9,
    ),
    *(metric for way, how in WAYS.items() for metric in _of(way, how)),
)  # fmt: skip
