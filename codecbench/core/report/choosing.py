"""One table for all links of a run: which setting to take over each, how sure that is, what limits the others."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from typing import Final

from codecbench.core.analysis.choosing import (
    Candidate,
    Demand,
    LeastError,
    NotMeasured,
    candidates,
    least_errors,
    links_of,
)
from codecbench.core.analysis.limits import POOLED
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.formatting import Verdict, where
from codecbench.core.report.tables import three_digits

_MUCH: Final = 0.05
"""Share of the pictures that must be missing more than of the best setting to be what limits another."""
_NAMED: Final = 3
"""Settings that a cell names before it counts the rest."""


def chosen(run: RunResult, demand: Demand) -> list[Verdict]:
    """What a run says of a demand, over each of its links where that names none ("").

    Where neither a deadline nor an error is asked, the setting that errs least. Raises NotMeasured.
    """
    links = [demand.link] if demand.link else links_of(run)
    for_links = [replace(demand, link=link) for link in links]
    if not links:
        raise NotMeasured(f"{run.folder}: no evaluator of it has a link, so that there is nothing to choose for")
    if demand.deadline_ms is None and demand.error_m is None:
        for asked in for_links:
            candidates(run, asked)  # says what there is in the place of a link that is not
        found = least_error_verdicts(run, demand.link or None)
        if not found:
            raise NotMeasured(f"{run.folder}: no error was measured over {', '.join(links)}; ask for a deadline")
        return found
    overview = [demand_verdict(run, demand)] if len(links) > 1 else []
    return overview + [verdict for asked in for_links for verdict in choices(run, asked)]


def least_error_verdicts(run: RunResult, link: str | None = None) -> list[Verdict]:
    """The setting that errs least over each link, or one: first of all sequences together, where there are several.

    Nothing where no error was measured over a link.
    """
    found: dict[bool, list[LeastError]] = defaultdict(list)
    for answer in least_errors(run):
        if link in (None, answer.link):
            found[answer.sequence == POOLED].append(answer)
    title = "least error over each link" if link is None else f"least error over {link}"
    pooled, single = f"{where(POOLED)}: {title}", f"by sequence: {title}" if found[True] else title
    return [_table(run, name, found[key]) for key, name in ((True, pooled), (False, single)) if found[key]]


def _table(run: RunResult, title: str, answers: list[LeastError]) -> Verdict:
    several = len({answer.sequence for answer in answers}) > 1
    heads = ["link", *(["sequence"] if several else []), "take", *_rate_heads(run), "error [m]", "how sure",
             "not told apart, at less rate", "limits of the others"]  # fmt: skip
    rows = [
        (answer.link, *([answer.sequence] if several else []), answer.best.name, rate_of(run, answer.best),
         f"{answer.error_m:.3g}", _sure(answer), _some(_cheaper(run, answer)) or "–", _limits(answer) or "–")
        for answer in answers
    ]  # fmt: skip
    runs = " or ".join(map(str, sorted({answer.runs for answer in answers})))
    sentences = (
        f"Errors are geometric means over {runs} runs of each setting. A setting is better than another with 95 % "
        "confidence, over all comparisons of its row together; else the two are not told apart.",
    )
    return Verdict(title, tuple(heads), tuple(rows), sentences)


def _rate_heads(run: RunResult) -> list[str]:
    return ["rate" if run.rate is None else f"rate [{run.rate.unit}]"]


def _sure(answer: LeastError) -> str:
    count = len(answer.worse) + len(answer.level)
    if not count:
        return "the only setting"
    of_them = f"all {count}" if answer.is_told else f"{len(answer.worse) or 'none'} of {count}"
    return f"better than {of_them} others"


def _cheaper(run: RunResult, answer: LeastError) -> list[str]:
    """Settings of less rate that may be as good."""
    less = [candidate for candidate in answer.level if candidate.rate < answer.best.rate]
    return [f"{candidate.name} ({rate_of(run, candidate)})" for candidate in less]


def _some(names: list[str]) -> str:
    rest = len(names) - _NAMED
    return ", ".join(names) if rest <= 1 else f"{', '.join(names[:_NAMED])} and {rest} more"


def _limits(answer: LeastError) -> str:
    found: dict[str, list[str]] = defaultdict(list)
    for candidate in answer.worse:
        missing = answer.best.share - candidate.share > _MUCH
        cause = f"pictures {next(iter(candidate.causes))}" if missing else "the error, though pictures come"
        found[cause if candidate.causes else "the error"].append(candidate.name)
    return _by_cause(found)


def _by_cause(found: dict[str, list[str]]) -> str:
    return "; ".join(f"{cause}: {_some(names)}" for cause, names in found.items())


def demand_verdict(run: RunResult, demand: Demand) -> Verdict:
    """What to take over each link of a run by what is asked, of all sequences together where there are several.

    The link of the demand does not matter. Raises NotMeasured.
    """
    rows = []
    for link in links_of(run):
        found = candidates(run, replace(demand, link=link))
        first = [candidate for candidate in found if candidate.sequence == found[0].sequence]
        holding = next((candidate for candidate in first if candidate.verdict == "passes"), None)
        others: dict[str, list[str]] = defaultdict(list)
        for candidate in first:
            if candidate.verdict != "passes":
                others[limit_of(candidate).split(" (")[0]].append(candidate.name)
        taken = (
            ("none is known to hold", "–", "–")
            if holding is None
            else (holding.name, rate_of(run, holding), "; ".join(map(str, holding.standings)))
        )
        rows.append((link, *taken, _by_cause(others) or "–"))
    names = [entry.name for entry in run.plan.sequences]
    title = f"{where(POOLED) if len(names) > 1 else names[0]}: over each link, {asked_words(demand)}"
    return Verdict(title, ("link", "take", *_rate_heads(run), "how sure", "limits of the others"), tuple(rows), ())


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
    yield "" if candidate.verdict == "passes" else limit_of(candidate)


def rate_of(run: RunResult, candidate: Candidate) -> str:
    """The rate of a setting in the unit that people are shown."""
    return "–" if run.rate is None or math.isnan(candidate.rate) else three_digits(candidate.rate * run.rate.factor)


def limit_of(candidate: Candidate) -> str:
    """What keeps a setting from being known to hold: why pictures are not in time, else what is made of them."""
    if candidate.unmeasured:
        return f"not measured: {', '.join(candidate.unmeasured)}"
    if candidate.timely is not None and candidate.timely.verdict != "passes" and candidate.share < 1.0:
        label, share = next(iter(candidate.causes.items()))
        return f"pictures {label} ({100 * share:.0f} %)"
    if candidate.exact is not None and candidate.exact.verdict == "fails":
        return "the error, though pictures come in time" if candidate.timely is not None else "the error"
    return "too few runs"


def _sentences(run: RunResult, demand: Demand, found: list[Candidate]) -> Iterator[str]:
    holding = [candidate for candidate in found if candidate.verdict == "passes"]
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
        if candidate.verdict == "inconclusive" and candidate.unmeasured:
            yield (
                f"{candidate.name} cannot be judged by {' and '.join(candidate.unmeasured)}: add an evaluator that "
                f"measures it with the same parameters of the link."
            )
        elif candidate.verdict == "inconclusive":
            yield f"{candidate.name} cannot be told: at least {candidate.more_runs} more repeats would tell."
