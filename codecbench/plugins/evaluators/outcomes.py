"""What became of frames on a link, as rows of a timeline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from codecbench.core.contracts.view import TimelineRow, Tone
from codecbench.core.simulation.receiver import FrameOutcome

_TONES: Final[dict[FrameOutcome, Tone]] = {
    "on time": "good", "concealed": "fair", "partial": "fair", "late": "bad", "lost": "bad", "broken": "bad",
    "skipped": "fair",
}  # fmt: skip
"""Nobody failed at a picture that was never sent: something newer took its place."""


def rows_of_outcomes(outcomes: Sequence[str]) -> tuple[TimelineRow, ...]:
    """A row for each outcome that a frame met, from the best to the worst. outcomes: of the frames (N,)."""
    told = np.array(outcomes, dtype=object)
    return tuple(TimelineRow(outcome, tone, told == outcome) for outcome, tone in _TONES.items() if outcome in outcomes)
