"""What an evaluator offers to draw. All of it is plain data: results draw it without knowing the evaluator."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import PluginError

ViewKind = Literal["curve", "bars", "map"]
Stroke = Literal["truth", "before", "after"]

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
        if self.kind not in get_args(ViewKind):
            choices = ", ".join(get_args(ViewKind))
            raise PluginError(f"view {self.title!r}: kind is {self.kind!r}; it is one of {choices}")
        least, most = _METRICS[self.kind]
        if isinstance(self.metrics, str) or not least <= len(self.metrics) <= most:
            counts = f"{least}" if least == most else f"{least} to {most}"
            raise PluginError(f"view {self.title!r}: metrics is {self.metrics!r}; a {self.kind} names {counts}")


@dataclass(frozen=True)
class Line:
    """A line of a drawing: its name, what it stands for, and its points (N, 2) in the plane of the drawing."""

    name: str
    stroke: Stroke
    points: NDArray[np.float64] = field(repr=False)

    def __post_init__(self) -> None:
        if self.stroke not in get_args(Stroke):
            raise PluginError(
                f"line {self.name!r}: stroke is {self.stroke!r}; it is one of {', '.join(get_args(Stroke))}"
            )
        if self.points.ndim != 2 or self.points.shape[1] != 2:
            raise PluginError(f"line {self.name!r}: points have shape {self.points.shape}; they are (N, 2)")


@dataclass(frozen=True)
class Drawing:
    """What a cell left, as lines on a map. holds: whether its task succeeded, or None where that is not known."""

    lines: tuple[Line, ...]
    caption: str
    holds: bool | None = None
