"""The table of docs/link.md: what `codecbench choose` answers for each link, beside the ends of the rates."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

from run_tables import Heads, table

from codecbench import RunResult
from codecbench.core.analysis.choosing import Candidate, Demand, candidates

ERROR_M: Final = 0.3
"""The live position error that is asked for."""


def choices(run: RunResult, heads: Heads) -> Iterator[str]:
    """For each link and sequence: the setting to take, the one of least error, and the two ends of the rates."""
    rows = []
    for link in links(run):
        found: dict[str, list[Candidate]] = {entry.name: [] for entry in run.plan.sequences}
        for candidate in candidates(run, Demand(link, None, ERROR_M, 1.0, None)):
            if candidate.sequence in found:
                found[candidate.sequence].append(candidate)
        for sequence, members in found.items():
            members.sort(key=lambda candidate: candidate.rate)
            taken = next((candidate for candidate in members if candidate.verdict == "holds"), None)
            known = [candidate for candidate in members if not math.isnan(candidate.error_m)]
            best = min(known, key=lambda candidate: candidate.error_m)
            answer = "none is known to hold" if taken is None else f"{taken.name}, {_rate(run, taken)}"
            errors = [f"{candidate.name}: {candidate.error_m:.2g}" for candidate in (best, members[0], members[-1])]
            rows.append([f"`{link}`", sequence, answer, *errors])
    yield table(heads, rows)


def links(run: RunResult) -> list[str]:
    """The links of a run, in the order of the matrix."""
    params = [cell.evaluator.params.get("link") for cell in run.plan.cells]
    return list(dict.fromkeys(link for link in params if link is not None))


def _rate(run: RunResult, candidate: Candidate) -> str:
    assert run.rate is not None
    return f"{candidate.rate * run.rate.factor:,.0f} {run.rate.unit}"
