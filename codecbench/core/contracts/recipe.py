"""Recipes: code to paste into a robot's software stack for a setting of a codec, and how its output differs."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

_RATE_DENOMINATOR = 1001


@dataclass(frozen=True)
class Scene:
    """The frames that a recipe is for."""

    height: int
    """In pixels."""
    width: int
    """In pixels."""
    channels: int
    """1 gray, 3 RGB."""
    frame_rate_hz: float
    bits: int = 8
    """Bits of a sample, 8 or 16."""

    @property
    def rate(self) -> Fraction:
        """The frame rate as a fraction, such as 30000/1001, as video stacks express it."""
        return Fraction(self.frame_rate_hz).limit_denominator(_RATE_DENOMINATOR)


@dataclass(frozen=True)
class Recipe:
    """Code to paste into one software stack to get the bytes that were measured."""

    stack: str
    """The stack, with the version whose option names the text uses."""
    language: Literal["yaml", "sh", "python"]
    text: str
    """The code; empty if the stack has no such codec or option.

    Python code defines `encode(frame)`, which returns the bytes of a frame in the layout that its argument names:
    `rgb`, `bgr` or `gray`. Given None at the end of a stream, it returns what the encoder held back."""
    note: str = ""
    """How the output differs from what was measured, or why there is no text; empty for neither."""
