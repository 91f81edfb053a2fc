"""What became of frames on a link, as lanes of a timeline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from codecbench.core.contracts.view import Lane, Tone
from codecbench.core.simulation.receiver import Fate

_TONES: Final[dict[Fate, Tone]] = {
    "on time": "good", "concealed": "fair", "partial": "fair", "late": "bad", "lost": "bad", "broken": "bad",
    "skipped": "fair",
}  # fmt: skip
"""Nobody failed at a picture that was never sent: something newer took its place."""


def lanes_of_fates(fates: Sequence[str]) -> tuple[Lane, ...]:
    """A lane for each fate that a frame met, from the best to the worst. fates: of the frames (N,)."""
    told = np.array(fates, dtype=object)
    return tuple(Lane(fate, tone, told == fate) for fate, tone in _TONES.items() if fate in fates)
