"""What an evaluator offers to draw. All of it is plain data: results draw it without knowing the evaluator."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import PluginError, require_choice
from codecbench.core.contracts.former_names import former_names

ViewKind = Literal["curve", "bars", "map"]
Stroke = Literal["truth", "before", "after"]
Tone = Literal["good", "fair", "bad"]

_METRICS: Final[dict[ViewKind, tuple[int, int]]] = {"curve": (1, 2), "bars": (1, 100), "map": (0, 0)}
"""How many metrics a view of each kind names, at the least and at the most."""


@dataclass(frozen=True)
class View:
    """Something that an evaluator offers to draw.

    kind: `curve`, the last of `metrics` over the first, or a single one over the rate; `bars`, each metric stacked by
    stage (`encode/dct`); `map`, the drawings that the evaluator reads from what its cells left. metrics: names of the
    evaluator's own. title: over the drawing. note: a sentence on how to read it.

    Headlines of role `quality` and `task` are drawn over the rate without a view.
    """

    kind: ViewKind
    title: str
    metrics: tuple[str, ...] = ()
    note: str = ""

    def __post_init__(self) -> None:
        require_choice(f"view {self.title!r}: kind", self.kind, ViewKind)
        least, most = _METRICS[self.kind]
        if isinstance(self.metrics, str) or not least <= len(self.metrics) <= most:
            counts = f"{least}" if least == most else f"{least} to {most}"
            raise PluginError(f"view {self.title!r}: metrics is {self.metrics!r}; a {self.kind} names {counts}")


@dataclass(frozen=True)
class KeypointOverlay:
    """Places of an original frame that matter to an evaluator, and which of them the decoded frame still has.

    places: (N, 2) x and y in pixels. kept: (N,). note: what the places are and what kept means, for people.
    """

    places: NDArray[np.float64] = field(repr=False)
    kept: NDArray[np.bool_] = field(repr=False)
    note: str

    def __post_init__(self) -> None:
        if self.places.ndim != 2 or self.places.shape[1] != 2 or self.kept.shape != self.places.shape[:1]:
            raise PluginError(
                f"marks {self.note!r}: places have shape {self.places.shape} and kept {self.kept.shape}; "
                "they are (N, 2) and (N,)"
            )


@dataclass(frozen=True)
class TimelineRow:
    """Frames of a timeline that share an outcome: its name, how good that is, and of which frames it holds (N,)."""

    name: str
    tone: Tone
    holds: NDArray[np.bool_] = field(repr=False)

    def __post_init__(self) -> None:
        require_choice(f"row {self.name!r}: tone", self.tone, Tone)
        if self.holds.ndim != 1 or self.holds.dtype != np.bool_:
            raise PluginError(
                f"row {self.name!r}: holds has shape {self.holds.shape} of {self.holds.dtype}; it is (N,) of bool"
            )


@former_names(lanes="rows")
@dataclass(frozen=True)
class FrameTimeline:
    """What became of each frame, in order.

    frames: (N,) indices in the sequence. positions: (N, 2) in the plane of the drawing, NaN where there is none; None
    where the drawing is no map. errors: (N,) how far off each is, NaN where that is not known. unit: of errors, and of
    positions. rows: what became of frames, in the order in which it is shown. quantity: what errors are, for people.
    """

    frames: NDArray[np.int64] = field(repr=False)
    positions: NDArray[np.float64] | None = field(repr=False)
    errors: NDArray[np.float64] = field(repr=False)
    unit: str
    rows: tuple[TimelineRow, ...] = ()
    quantity: str = "error"

    def __post_init__(self) -> None:
        count = len(self.frames)
        shape = None if self.positions is None else self.positions.shape
        if shape not in (None, (count, 2)) or self.errors.shape != (count,):
            raise PluginError(
                f"timeline: {count} frames, positions {shape} and errors {self.errors.shape}; they are (N, 2) and (N,)"
            )
        for row in self.rows:
            if len(row.holds) != count:
                raise PluginError(f"timeline: row {row.name!r} is of {len(row.holds)} frames; the timeline has {count}")
        if any(np.isinf(values).any() for values in (self.positions, self.errors) if values is not None):
            raise PluginError("timeline: a position or error is infinite; what is not known is NaN")


@dataclass(frozen=True)
class Line:
    """A line of a drawing: its name, what it stands for, and its points (N, 2) in the plane of the drawing."""

    name: str
    stroke: Stroke
    points: NDArray[np.float64] = field(repr=False)

    def __post_init__(self) -> None:
        require_choice(f"line {self.name!r}: stroke", self.stroke, Stroke)
        if self.points.ndim != 2 or self.points.shape[1] != 2:
            raise PluginError(f"line {self.name!r}: points have shape {self.points.shape}; they are (N, 2)")


@former_names(course="timeline")
@dataclass(frozen=True)
class Drawing:
    """What a cell left, as lines on a map. holds: whether its task succeeded, or None where that is not known.

    axes: what the two axes show, where they have scales of their own; empty for a plane, whose axes have one.
    timeline: what became of each frame.
    """

    lines: tuple[Line, ...]
    caption: str
    holds: bool | None = None
    axes: tuple[str, ...] = ()
    timeline: FrameTimeline | None = None

    def __post_init__(self) -> None:
        if isinstance(self.axes, str) or len(self.axes) not in (0, 2):
            raise PluginError(f"drawing {self.caption!r}: axes is {self.axes!r}; it names both axes, or none")

    @property
    def labels(self) -> tuple[str, ...]:
        """What stands at the two axes."""
        unit = f" [{self.timeline.unit}]" if self.timeline and self.timeline.positions is not None else ""
        return self.axes or (f"x{unit}", f"y{unit}")
