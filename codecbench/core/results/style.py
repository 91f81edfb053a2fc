"""Colours, markers and strokes: one home for the figures and the page."""

from __future__ import annotations

from collections import Counter
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
_DASHES: Final[tuple[tuple[float, ...], ...]] = ((), (5.0, 2.0), (1.5, 1.5), (6.0, 2.0, 1.5, 2.0))


@dataclass(frozen=True)
class CurveStyle:
    """Colour of a curve, the marker's name in matplotlib and on the page, and lengths of dashes and gaps in points."""

    colour: str
    marker: str
    symbol: str
    dashes: tuple[float, ...] = ()

    @property
    def linestyle(self) -> tuple[float, tuple[float, ...]] | str:
        """The dashes as matplotlib takes them."""
        return (0.0, self.dashes) if self.dashes else "-"


@dataclass(frozen=True)
class LineStyle:
    """Colour, dash in matplotlib and on the page, and width in points of a drawing's line."""

    colour: str
    dash: str
    dashes: str
    width: float


STROKES: Final[dict[Stroke, LineStyle]] = {
    "truth": LineStyle("#8a8f98", "-", "", 3.6),
    "before": LineStyle(PALETTE[4], "--", "3 2", 1.2),
    "after": LineStyle(PALETTE[0], "-", "", 1.4),
}


def curve_styles(curves: Iterable[str], baselines: Iterable[str]) -> dict[str, CurveStyle]:
    """A style for every curve of a run, the same in every figure and on the page.

    A codec has one colour, and its curves differ in dashes and markers. Colours repeat after eight codecs, with other
    dashes and markers: eight curves of a colour are told apart. baselines: names of codecs whose curves are neutral.
    """
    neutral = set(baselines)
    styles: dict[str, CurveStyle] = {}
    codecs: dict[str, int] = {}
    used: Counter[int] = Counter()
    for curve in dict.fromkeys(curves):
        codec = curve.split(" ")[0]
        if codec in neutral:
            styles[curve] = CurveStyle(NEUTRAL, *_MARKERS[0])
            continue
        colour = codecs.setdefault(codec, len(codecs)) % len(PALETTE)
        marker, symbol = _MARKERS[(colour + used[colour]) % len(_MARKERS)]
        styles[curve] = CurveStyle(PALETTE[colour], marker, symbol, _DASHES[used[colour] % len(_DASHES)])
        used[colour] += 1
    return styles
