"""Colours, markers and strokes: one home for the figures and the page."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from codecbench.core.contracts.view import Stroke

PALETTE: Final = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6BB1", "#A6761D")
"""Okabe and Ito's colours, which colour-blind readers can tell apart, and two that go with them."""
NEUTRAL: Final = "#777777"
"""What others are compared with: baseline codecs, ground truth."""
FAILED: Final = "#a02020"

_MARKERS: Final = (
    ("o", "circle"), ("s", "square"), ("D", "diamond"), ("^", "triangle-up"), ("P", "cross"), ("X", "x"),
    ("*", "star"), ("h", "hexagon"),
)  # fmt: skip


@dataclass(frozen=True)
class CurveStyle:
    """Colour of a codec's curve, and its marker's name in matplotlib and in plotly."""

    colour: str
    marker: str
    symbol: str


@dataclass(frozen=True)
class LineStyle:
    """Colour, dash and width in points of a drawing's line, and the dash's name in plotly."""

    colour: str
    dash: str
    plotly_dash: str
    width: float


STROKES: Final[dict[Stroke, LineStyle]] = {
    "truth": LineStyle("#8a8f98", "-", "solid", 3.6),
    "before": LineStyle(PALETTE[4], "--", "dot", 1.2),
    "after": LineStyle(PALETTE[0], "-", "solid", 1.4),
}


def curve_styles(curves: Iterable[str], baselines: Iterable[str]) -> dict[str, CurveStyle]:
    """A style for every curve of a run, the same in every figure and on the page.

    Colours and markers repeat after eight; then each colour comes with another marker. baselines: names of codecs
    whose curves are neutral.
    """
    neutral = set(baselines)
    styles: dict[str, CurveStyle] = {}
    count = len(PALETTE)
    coloured = 0
    for curve in dict.fromkeys(curves):
        is_neutral = curve.split(" ")[0] in neutral
        marker, symbol = _MARKERS[(coloured + coloured // count) % len(_MARKERS)]
        styles[curve] = CurveStyle(NEUTRAL if is_neutral else PALETTE[coloured % count], marker, symbol)
        coloured += not is_neutral
    return styles
