"""Which setting to take over a link, as rows and sentences."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from itertools import groupby

from codecbench.core.results.choosing.candidates import Candidate, Demand, candidates
from codecbench.core.results.numbers import three_digits
from codecbench.core.results.ranking.words import Verdict, where
from codecbench.core.results.run_result import RunResult


def choices(run: RunResult, demand: Demand) -> list[Verdict]:
    """A verdict for all sequences together, where there are several, and one for each. Raises NotMeasured."""
    found = candidates(run, demand)
    return [
        _verdict(run, demand, sequence, list(members))
        for sequence, members in groupby(found, key=lambda candidate: candidate.sequence)
    ]


def _verdict(run: RunResult, demand: Demand, sequence: str, found: list[Candidate]) -> Verdict:
    rate = "rate" if run.rate is None else f"rate [{run.rate.unit}]"
    heads = ["setting", rate]
    heads += ["in time"] if demand.deadline_ms is not None else []
    heads += ["error [m]"] if demand.error_m is not None else []
    heads += ["verdict", "limited by"]
    rows = tuple(tuple(_row(run, demand, candidate)) for candidate in found)
    title = f"{where(sequence)}: over {demand.link}, {asked_words(demand)}"
    return Verdict(title, tuple(heads), rows, tuple(_sentences(run, demand, found)))


def asked_words(demand: Demand) -> str:
    """What is asked, without the link."""
    asked = []
    if demand.deadline_ms is not None:
        device = "" if demand.device_factor is None else f" of a device {demand.device_factor:g} times slower"
        asked.append(f"{100 * demand.share:g} % of the pictures{device} within {demand.deadline_ms:g} ms")
    if demand.error_m is not None:
        asked.append(f"an error of at most {demand.error_m:g} m")
    return " and ".join(asked)


def _row(run: RunResult, demand: Demand, candidate: Candidate) -> Iterator[str]:
    yield candidate.name
    yield rate_of(run, candidate)
    if demand.deadline_ms is not None:
        timely = candidate.timely
        yield "–" if timely is None else f"{100 * candidate.share:.0f} % ({timely.successes}/{timely.runs} runs)"
    if demand.error_m is not None:
        exact = candidate.exact
        yield "–" if exact is None else f"{candidate.error_m:.3g} ({exact.successes}/{exact.runs} runs)"
    yield candidate.verdict
    yield "" if candidate.verdict == "holds" else limit_of(candidate)


def rate_of(run: RunResult, candidate: Candidate) -> str:
    """The rate of a setting in the unit that people are shown."""
    return "–" if run.rate is None or math.isnan(candidate.rate) else three_digits(candidate.rate * run.rate.factor)


def limit_of(candidate: Candidate) -> str:
    """What keeps a setting from being known to hold: why pictures are not in time, else what is made of them."""
    if candidate.unmeasured:
        return f"not measured: {', '.join(candidate.unmeasured)}"
    if candidate.timely is not None and candidate.timely.verdict != "holds" and candidate.share < 1.0:
        label, share = next(iter(candidate.causes.items()))
        return f"pictures {label} ({100 * share:.0f} %)"
    if candidate.exact is not None and candidate.exact.verdict == "fails":
        return "the error, though pictures come in time" if candidate.timely is not None else "the error"
    return "too few runs"


def _sentences(run: RunResult, demand: Demand, found: list[Candidate]) -> Iterator[str]:
    holding = [candidate for candidate in found if candidate.verdict == "holds"]
    if holding:
        taken = holding[0]
        sure = "; ".join(str(standing) for standing in taken.standings)
        spent = "" if run.rate is None else f", {rate_of(run, taken)} {run.rate.unit}"
        many = f"{'the first' if run.rate is None else 'the least'} of {len(holding)} settings that hold"
        why = many if len(holding) > 1 else "the only setting that holds"
        yield f"Over {demand.link} take {taken.name}{spent}, {why} ({sure})."
    else:
        yield f"Over {demand.link} no setting is known to hold."
    if run.rate is None:
        yield "No rate was measured, so that settings stand in the order of the matrix; add an evaluator that has one."
    failing: dict[str, list[str]] = defaultdict(list)
    for candidate in found:
        if candidate.verdict == "fails":
            failing[limit_of(candidate).split(" (")[0]].append(candidate.name)
    for limit, names in failing.items():
        yield f"Limited by {limit}: {', '.join(names)}."
    for candidate in found:
        if candidate.verdict == "cannot tell" and candidate.unmeasured:
            yield (
                f"{candidate.name} cannot be judged by {' and '.join(candidate.unmeasured)}: add an evaluator that "
                f"measures it with the same parameters of the link."
            )
        elif candidate.verdict == "cannot tell":
            yield f"{candidate.name} cannot be told: at least {candidate.more_runs} more repeats would tell."
