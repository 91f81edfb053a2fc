"""Settings of several parameters, chosen by Optuna's tree-structured Parzen estimator.

Source: Bergstra et al., Algorithms for hyper-parameter optimization, NeurIPS 2011, as Optuna has it. A parameter is
sampled by the place of its value, so that equal answers to equal questions lead the same way again.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Final

_AT_ONCE: Final = 4
"""Settings that are tried in the same round."""
_BARRED: Final = 1e12
"""More than any cost: the sampler goes by the order of costs alone, in which settings that will not do come last."""


@dataclass(frozen=True)
class Score:
    """What a place is worth. cost: to be least; infinite where unknown. violation: above 0 where it will not do."""

    cost: float
    violation: float


def sampling(lengths: Sequence[int], budget: int, seed: int) -> Generator[list[int], dict[int, Score], None]:
    """Yields places, in the order in which all combinations stand, and is sent the score of each; at most `budget`."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    sampler = optuna.samplers.TPESampler(seed=seed, n_startup_trials=min(10, budget // 2))
    study = optuna.create_study(sampler=sampler)
    known: dict[int, Score] = {}
    most = min(budget, math.prod(lengths))
    for _ in range(10 * budget):  # the sampler may come back to where it was
        if len(known) >= most or Score(0.0, 0.0) in known.values():
            return
        asked = [study.ask() for _ in range(min(_AT_ONCE, most - len(known)))]
        places = [_place([trial.suggest_int(str(axis), 0, length - 1) for axis, length in enumerate(lengths)], lengths)
                  for trial in asked]  # fmt: skip
        new = [place for place in dict.fromkeys(places) if place not in known]
        if new:
            known |= yield new
        for trial, place in zip(asked, places, strict=True):
            score = known[place]
            study.tell(trial, min(score.cost, _BARRED) if score.violation == 0.0 else _BARRED * (1.0 + score.violation))


def _place(parts: Sequence[int], lengths: Sequence[int]) -> int:
    place = 0
    for part, length in zip(parts, lengths, strict=True):
        place = place * length + part
    return place
