"""Delivery outcomes of frames as rows of a timeline."""

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
"""A frame that was skipped is no failure: a newer one was sent in its place."""


def rows_of_outcomes(outcomes: Sequence[str]) -> tuple[TimelineRow, ...]:
    """One row for each outcome that occurs, from best to worst. outcomes: (N,) one for each frame."""
    values = np.array(outcomes, dtype=object)
    return tuple(
        TimelineRow(outcome, tone, values == outcome) for outcome, tone in _TONES.items() if outcome in outcomes
    )
