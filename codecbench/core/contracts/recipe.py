"""What one pastes into a robot for a setting of a codec: text of the stack that runs there, and what differs there."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

_RATE_DENOMINATOR = 1001


@dataclass(frozen=True)
class Scene:
    """The frames that a recipe is for. height, width: in pixels. channels: 1 gray, 3 RGB."""

    height: int
    width: int
    channels: int
    frame_rate_hz: float

    @property
    def rate(self) -> Fraction:
        """The frame rate as stacks have it."""
        return Fraction(self.frame_rate_hz).limit_denominator(_RATE_DENOMINATOR)


@dataclass(frozen=True)
class Recipe:
    """What one pastes to get the bytes that were measured.

    stack: what it is for, with the version by which keys are named. text: empty if that stack cannot code so. A Python
    text defines `encode(frame)`, which returns the bytes of a frame (uint8) in the layout that its argument names:
    `rgb`, `bgr` or `gray`. Given None at the end of a stream, it returns what was held back. note: what differs there
    from what was measured, or why there is no text; empty for nothing.
    """

    stack: str
    language: Literal["yaml", "sh", "python"]
    text: str
    note: str = ""
