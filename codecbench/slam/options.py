"""Settings that a caller may choose; thresholds.py holds the fixed ones."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Options:
    """Settings of a run. Raises ValueError if a value is out of range."""

    features: int = 1000
    """Most ORB features in a frame, 100 to 10,000."""
    levels: int = 8
    """Pyramid levels, 1 to 16."""
    scale_factor: float = 1.2
    """Ratio of two pyramid levels, above 1 and up to 2."""
    loop_closing: bool = True
    """Whether to close loops and to merge maps of one place."""
    final_bundle_adjustment: bool = True
    """Whether `System.finish` adjusts each map once more."""

    def __post_init__(self) -> None:
        if not 100 <= self.features <= 10000:
            raise ValueError(f"Options.features: {self.features} is not in 100..10000")
        if not 1 <= self.levels <= 16:
            raise ValueError(f"Options.levels: {self.levels} is not in 1..16")
        if not 1.0 < self.scale_factor <= 2.0:
            raise ValueError(f"Options.scale_factor: {self.scale_factor} is not above 1 and at most 2")
