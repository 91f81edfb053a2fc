"""What a caller may choose: the thresholds of thresholds.py are not choices."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """Settings of a run.

    `features`: ORB features kept in a frame (100..10000); `levels`: pyramid levels (1..16); `scale_factor`: between two
    levels (above 1, to 2); `loop_closing`: look for loops, and for maps of one place to merge;
    `final_bundle_adjustment`: adjust each map once more in `System.finish`. Raises ValueError when a value is out of
    range.
    """

    features: int = 1000
    levels: int = 8
    scale_factor: float = 1.2
    loop_closing: bool = True
    final_bundle_adjustment: bool = True

    def __post_init__(self) -> None:
        if not 100 <= self.features <= 10000:
            raise ValueError(f"Options.features: {self.features} is not in 100..10000")
        if not 1 <= self.levels <= 16:
            raise ValueError(f"Options.levels: {self.levels} is not in 1..16")
        if not 1.0 < self.scale_factor <= 2.0:
            raise ValueError(f"Options.scale_factor: {self.scale_factor} is not above 1 and up to 2")
