"""Charts that evaluators offer, as plain data: results are drawn without loading the evaluator."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import PluginError, former_names, require_choice

ViewKind = Literal["curve", "bars", "map"]
Stroke = Literal["truth", "before", "after"]
Tone = Literal["good", "fair", "bad"]

_METRICS: Final[dict[ViewKind, tuple[int, int]]] = {"curve": (1, 2), "bars": (1, 100), "map": (0, 0)}
"""Least and greatest number of metrics that a view of each kind names."""


@dataclass(frozen=True)
class View:
    """A chart that an evaluator offers.

    Primary metrics of role `quality` and `task` are drawn over the rate without a view.
    """

    kind: ViewKind
    """`curve`: the last of `metrics` over the first, or a single one over the rate. `bars`: each metric, stacked by
    stage (`encode/dct`). `map`: the evaluator's `drawing` of each cell."""
    title: str
    metrics: tuple[str, ...] = ()
    """Names of metrics that the evaluator declares."""
    note: str = ""
    """A sentence on how to read the chart."""

    def __post_init__(self) -> None:
        require_choice(f"view {self.title!r}: kind", self.kind, ViewKind)
        least, most = _METRICS[self.kind]
        if isinstance(self.metrics, str) or not least <= len(self.metrics) <= most:
            counts = f"{least}" if least == most else f"{least} to {most}"
            raise PluginError(f"view {self.title!r}: metrics is {self.metrics!r}; a {self.kind} names {counts}")


@dataclass(frozen=True)
class KeypointOverlay:
    """Keypoints of an original frame, and which of them the decoded frame preserves."""

    places: NDArray[np.float64] = field(repr=False)
    """(N, 2) x and y in pixels."""
    kept: NDArray[np.bool_] = field(repr=False)
    """(N,) True for keypoints that the decoded frame preserves."""
    note: str
    """Explains to readers what the keypoints are and when one counts as preserved."""

    def __post_init__(self) -> None:
        if self.places.ndim != 2 or self.places.shape[1] != 2 or self.kept.shape != self.places.shape[:1]:
            raise PluginError(
                f"marks {self.note!r}: places have shape {self.places.shape} and kept {self.kept.shape}; "
                "they must be (N, 2) and (N,)"
            )


@dataclass(frozen=True)
class TimelineRow:
    """The frames of a timeline that share a delivery outcome."""

    name: str
    """Name of the outcome."""
    tone: Tone
    """How good the outcome is."""
    holds: NDArray[np.bool_] = field(repr=False)
    """(N,) True for frames with this outcome."""

    def __post_init__(self) -> None:
        require_choice(f"row {self.name!r}: tone", self.tone, Tone)
        if self.holds.ndim != 1 or self.holds.dtype != np.bool_:
            raise PluginError(
                f"row {self.name!r}: holds has shape {self.holds.shape} of {self.holds.dtype}; it must be (N,) of bool"
            )


@former_names(lanes="rows")
@dataclass(frozen=True)
class FrameTimeline:
    """Position, error and outcome of each frame, in order."""

    frames: NDArray[np.int64] = field(repr=False)
    """(N,) indices in the sequence."""
    positions: NDArray[np.float64] | None = field(repr=False)
    """(N, 2) in the plane of the drawing, NaN if unknown; None if the drawing is no map."""
    errors: NDArray[np.float64] = field(repr=False)
    """(N,) NaN if unknown."""
    unit: str
    """Unit of errors and positions."""
    rows: tuple[TimelineRow, ...] = ()
    """Outcomes, in display order."""
    quantity: str = "error"
    """What `errors` are, for readers."""

    def __post_init__(self) -> None:
        count = len(self.frames)
        shape = None if self.positions is None else self.positions.shape
        if shape not in (None, (count, 2)) or self.errors.shape != (count,):
            raise PluginError(
                f"timeline: {count} frames, positions {shape} and errors {self.errors.shape}; must be (N, 2) and (N,)"
            )
        for row in self.rows:
            if len(row.holds) != count:
                raise PluginError(f"timeline: row {row.name!r} is of {len(row.holds)} frames; the timeline has {count}")
        if any(np.isinf(values).any() for values in (self.positions, self.errors) if values is not None):
            raise PluginError("timeline: a position or error is infinite; use NaN for unknown values")


@dataclass(frozen=True)
class Line:
    """A line of a drawing."""

    name: str
    stroke: Stroke
    """What it shows: the ground truth, or the result before or after corrections."""
    points: NDArray[np.float64] = field(repr=False)
    """(N, 2) in the plane of the drawing."""

    def __post_init__(self) -> None:
        require_choice(f"line {self.name!r}: stroke", self.stroke, Stroke)
        if self.points.ndim != 2 or self.points.shape[1] != 2:
            raise PluginError(f"line {self.name!r}: points have shape {self.points.shape}; they must be (N, 2)")


@former_names(course="timeline")
@dataclass(frozen=True)
class Drawing:
    """Result of a cell, as lines on a map."""

    lines: tuple[Line, ...]
    caption: str
    holds: bool | None = None
    """Whether the cell's task succeeded; None if unknown."""
    axes: tuple[str, ...] = ()
    """Labels of the two axes if each has its own scale; empty for a plane, whose axes share one."""
    timeline: FrameTimeline | None = None
    """Position, error and outcome of each frame."""

    def __post_init__(self) -> None:
        if isinstance(self.axes, str) or len(self.axes) not in (0, 2):
            raise PluginError(f"drawing {self.caption!r}: axes is {self.axes!r}; it must name both axes or none")

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels of the two axes."""
        unit = f" [{self.timeline.unit}]" if self.timeline and self.timeline.positions is not None else ""
        return self.axes or (f"x{unit}", f"y{unit}")
