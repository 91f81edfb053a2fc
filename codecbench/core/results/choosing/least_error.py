"""The setting over a link of which a reader errs least, and how sure it is that no other errs less.

Source: multiple comparisons with the best (Hsu 1984, doi:10.1214/aos/1176346732). Deviation: Bonferroni's bound in the
place of Dunnett's, because runs are paired and their differences vary by setting.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Final

import numpy as np

from codecbench.core.results.choosing.candidates import Candidate, Demand, RunKey, candidates, links_of
from codecbench.core.results.evidence import combined, evidence_of_repeats
from codecbench.core.results.run_result import RunResult

_SIGNIFICANCE: Final = 0.05
"""Chance that the setting that errs least is said to be worse than another."""


@dataclass(frozen=True)
class LeastError:
    """What a run answers of a link, on a sequence or on all (POOLED).

    best: the setting of the least error. error_m: its geometric mean over runs. worse: those that are known to err
    more. level: all others, in order of rate, any of which may be the best. runs: of each setting.
    """

    link: str
    sequence: str
    best: Candidate
    error_m: float
    worse: tuple[Candidate, ...]
    level: tuple[Candidate, ...]
    runs: int

    @property
    def is_told(self) -> bool:
        """Whether no other setting may be the best."""
        return not self.level and bool(self.worse)


def least_errors(run: RunResult) -> list[LeastError]:
    """The answers of every link over which errors were measured: of all sequences together first, where several."""
    found = []
    for link in links_of(run):
        demand = Demand(link, deadline_ms=math.inf, error_m=math.inf)
        for sequence, members in groupby(candidates(run, demand), key=lambda candidate: candidate.sequence):
            judged = [candidate for candidate in members if candidate.errors_m]
            if judged and (answer := _least(link, sequence, judged)):
                found.append(answer)
    return found


def _least(link: str, sequence: str, judged: list[Candidate]) -> LeastError | None:
    """None where no run that all settings share has an error. A run that failed counts as the worst of all runs."""
    shared = sorted(set.intersection(*(set(candidate.errors_m) for candidate in judged)))
    table = np.array([[candidate.errors_m[key] for key in shared] for candidate in judged])
    finite = table[np.isfinite(table) & (table > 0.0)]
    if not len(finite):
        return None
    logs = np.log(np.clip(np.where(np.isnan(table), math.inf, table), finite.min(), finite.max()))
    means = np.array([_mean(dict(zip(shared, row, strict=True))) for row in logs])
    at = int(np.argmin(means))
    limit = _SIGNIFICANCE / max(1, len(judged) - 1)
    is_worse = [_chance(dict(zip(shared, row - logs[at], strict=True))) < limit for row in logs]
    others = [(candidate, worse) for place, (candidate, worse) in enumerate(zip(judged, is_worse, strict=True))
              if place != at]  # fmt: skip
    return LeastError(
        link,
        sequence,
        judged[at],
        float(np.exp(means[at])),
        tuple(candidate for candidate, worse in others if worse),
        tuple(candidate for candidate, worse in others if not worse),
        len(shared),
    )


def _by_sequence(values: Mapping[RunKey, float]) -> list[np.ndarray]:
    of: dict[str, list[float]] = defaultdict(list)
    for (sequence, _), value in values.items():
        of[sequence].append(value)
    return [np.array(members) for members in of.values()]


def _mean(values: Mapping[RunKey, float]) -> float:
    """Over sequences of the same weight."""
    return float(np.mean([members.mean() for members in _by_sequence(values)]))


def _chance(differences: Mapping[RunKey, float]) -> float:
    """One-sided, that such differences are above zero by luck."""
    evidence = combined([evidence_of_repeats(members) for members in _by_sequence(differences)])
    return evidence.p_value / 2.0 if evidence.mean > 0.0 else 1.0
