"""The setting to take over each link of a run, and why others fail."""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby
from typing import Final

from codecbench.core.analysis.choosing import (
    FRESH_SHARE,
    IDLE_ERROR,
    Candidate,
    Demand,
    Shortfall,
    candidates,
    links_of,
    links_with_readers,
)
from codecbench.core.analysis.passing import Standing
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.verdicts import median
from codecbench.core.contracts.metric import FRESH_S
from codecbench.core.report.costs import deciding_cost, rate_cell, rate_words
from codecbench.core.report.formatting import (
    Verdict,
    compact_table,
    curves_without_pick,
    format_percent,
    sequence_words,
)
from codecbench.core.report.tables import padded_digits, three_digits

_NAMED: Final = 3
"""Settings that a sentence names before it counts the rest."""
_FRESH: Final = f"a pose no older than {FRESH_S:g} s at"
_GROUPS: Final[dict[Shortfall, tuple[str, str]]] = {
    "time": ("too few frames on time", "have too few frames before the deadline"),
    "failed": ("failed runs", "failed in most runs"),
    "fresh": ("too few fresh poses", "have too few fresh poses"),
    "error": ("error too large", "have too large an error"),
    "idle": ("no better than nothing received", "are no better than with nothing received"),
    "unmeasured": ("not measured", "are not measured in full"),
    "runs": ("too few runs", "have too few runs"),
}
"""What keeps settings from passing: in a cell of a table, and in a sentence."""


def candidates_over_links(run: RunResult) -> list[list[Candidate]]:
    """The settings over each link with a reader, on all sequences together, by rate."""
    return [groups[0] for groups in _candidates_by_link(run, Demand(""))] if links_with_readers(run) else []


def link_verdicts(run: RunResult) -> list[Verdict]:
    """The choices over each link with a reader, without further demands."""
    return choices(run, Demand("")) if links_with_readers(run) else []


def choices(run: RunResult, demand: Demand) -> list[Verdict]:
    """Judge a demand over its link, or over each if it names none (""): tables, and last the answers.

    Raises NotMeasured.
    """
    links = _candidates_by_link(run, demand)
    tables = [_table(run, settings, is_first=settings is groups[0]) for groups in links for settings in groups]
    answers = tuple(answer(run, groups[0]) for groups in links)
    return [*tables, Verdict("answer", (), (), answers)]


def link_picks(run: RunResult, demand: Demand) -> list[Verdict]:
    """A table of the picks over a link, or one over each link, on all sequences together. Raises NotMeasured."""
    return [_picks(run, groups[0]) for groups in _candidates_by_link(run, demand)]


def _picks(run: RunResult, settings: list[Candidate]) -> Verdict:
    """A row a codec: its setting of lowest rate that passes and the next coarser one; if none passes, the nearest."""
    by_curve: dict[str, list[Candidate]] = defaultdict(list)
    for candidate in sorted(settings, key=lambda candidate: candidate.verdict != "passes"):
        by_curve[candidate.curve].append(candidate)
    passing = {curve: members[0] for curve, members in by_curve.items() if members[0].verdict == "passes"}
    anchors = [candidate for candidate in passing.values() if candidate.curve.split(" ")[0] in run.schema.anchors]
    rows = []
    for curve, taken in (passing or {curve: _nearest(members) for curve, members in by_curve.items()}).items():
        row = {"codec": curve, "setting": f"{taken.point} {taken.way}".strip()}
        row |= dict([rate_cell(run, taken.sequence, curve, _setting(taken))])
        if anchors:
            beside = "" if taken is anchors[0] else f"{format_percent(_extra_percent(run, taken, anchors[0]))} %"
            row[f"vs. {anchors[0].curve}"] = beside
        row["error m"] = "" if math.isnan(taken.error_m) else padded_digits(taken.error_m)
        row["fresh"] = "" if math.isnan(taken.fresh) else _percent(taken.fresh)
        row["on time"] = "" if math.isnan(taken.share) else _percent(taken.share)
        row["runs"] = " and ".join(f"{standing.successes}/{standing.runs}" for standing in taken.standings)
        if taken.limit is None:
            coarser = [candidate for candidate in settings[: settings.index(taken)] if candidate.curve == curve]
            row["next coarser"] = f"{coarser[-1].point} {coarser[-1].verdict}" if coarser else "none tried"
        else:
            row["verdict"] = f"{taken.verdict}: {_GROUPS[taken.limit][0]}"
        rows.append(row)
    demand = settings[0].demand
    table = compact_table(
        f"The pick of each codec over {demand.link}, {sequence_words(settings[0].sequence)}, {demand_words(demand)}",
        rows,
    )
    others = [curve for curve in by_curve if passing and curve not in passing]
    return replace(
        table,
        sentences=(
            *table.sentences,
            *curves_without_pick(
                [curve for curve in others if all(member.verdict == "fails" for member in by_curve[curve])], others
            ),
        ),
    )


def _nearest(settings: list[Candidate]) -> Candidate:
    return max(settings, key=lambda candidate: [standing.successes for standing in candidate.standings])


def _candidates_by_link(run: RunResult, demand: Demand) -> list[list[list[Candidate]]]:
    """Candidates by link and sequence, those of all sequences together first."""
    usable = links_with_readers(run) if demand.deadline_ms is None else links_of(run)
    links = [demand.link] if demand.link else usable or links_of(run)[:1] or [""]
    over = (candidates(run, replace(demand, link=link)) for link in links)
    return [
        [list(members) for _, members in groupby(settings, key=lambda setting: setting.sequence)] for settings in over
    ]


def _passing(settings: list[Candidate]) -> list[Candidate]:
    return [candidate for candidate in settings if candidate.verdict == "passes"]


def _names_and_count(names: list[str]) -> str:
    rest = len(names) - _NAMED
    return ", ".join(names) if rest <= 1 else f"{', '.join(names[:_NAMED])} and {rest} more"


def _table(run: RunResult, settings: list[Candidate], is_first: bool) -> Verdict:
    """is_first: whether it is the link's first table, which states the rule; others have an answer of their own."""
    demand = settings[0].demand
    rate = "rate" if run.rate is None else f"rate [{run.rate.unit}]"
    heads = ("setting", rate, *(["on time"] if demand.deadline_ms is not None else []),
             "error [m]", "fresh pose", "runs", "verdict", "because")  # fmt: skip
    title = f"{sequence_words(settings[0].sequence)}: over {demand.link}, {demand_words(demand)}"
    rows = tuple(tuple(_row(run, candidate)) for candidate in settings)
    return Verdict(title, heads, rows, (_rule(settings) if is_first else answer(run, settings), *_notes(run, settings)))


def demand_words(demand: Demand) -> str:
    """The demand in words, without the link."""
    words = []
    if demand.deadline_ms is not None:
        device = "" if demand.device_factor is None else f" of a device {demand.device_factor:g} times slower"
        words.append(f"{100 * demand.share:g} % of the frames{device} within {demand.deadline_ms:g} ms")
    if demand.error_m is not None:
        words.append(f"an error of at most {demand.error_m:g} m")
    return " and ".join(words) or "a smaller error than with nothing received"


def _rule(settings: list[Candidate]) -> str:
    """When a setting passes."""
    error_m = settings[0].demand.error_m
    asked = "" if error_m is None else f"at most {error_m:g} m and "
    reader = (
        f"A run needs {_FRESH} {_percent(FRESH_SHARE)} of capture times or more. Its error must be {asked}smaller "
        "than with nothing received (the center of the true path)."
    )
    is_read = any(candidate.readings for candidate in settings)
    passes = "A setting passes if the 95 % confidence interval of its success rate lies above 50 %."
    return f"{reader if is_read else 'No evaluator reads the frames, so only their delivery is judged.'} {passes}"


def _row(run: RunResult, candidate: Candidate) -> Iterator[str]:
    yield candidate.name
    yield "–" if run.rate is None else _number(candidate.rate * run.rate.factor)
    if candidate.demand.deadline_ms is not None:
        yield "–" if math.isnan(candidate.share) else _percent(candidate.share)
    yield _number(candidate.error_m)
    yield "–" if math.isnan(candidate.fresh) else _percent(candidate.fresh)
    counts = " and ".join(f"{standing.successes}/{standing.runs}" for standing in candidate.standings)
    yield "–" if candidate.limit == "unmeasured" else counts
    yield candidate.verdict
    yield limit_of(candidate)


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"


def _number(value: float) -> str:
    return "–" if math.isnan(value) else three_digits(value)


def limit_of(candidate: Candidate) -> str:
    """What keeps a setting from passing, in numbers; empty if it passes."""
    limit, demand = candidate.limit, candidate.demand
    if limit is None:
        return ""
    if limit == "unmeasured":
        return f"not measured: {', '.join(candidate.unmeasured)}"
    short = [reading for reading in candidate.readings if reading.shortfall(demand) == limit]
    error_m, idle_m = (_number(median(getattr(reading, name) for reading in short)) for name in ("error_m", "idle_m"))
    fresh = _percent(median(reading.fresh for reading in short))
    cause, share = next(iter(candidate.causes.items()), ("", math.nan))
    words = {
        "time": f"{_percent(candidate.share)} of frames before the deadline ({_percent(demand.share)} required), "
        f"{_percent(share)} {cause}",
        "failed": "failed",
        "fresh": f"{_FRESH} {fresh} of capture times < {_percent(FRESH_SHARE)}",
        "error": f"error {error_m} m > {_number(demand.error_m or math.nan)} m",
        "idle": f"error {error_m} m is no better than {idle_m} m with nothing received",
        "runs": f"only {min((standing.runs for standing in candidate.standings), default=0)} runs",
    }[limit]
    if 0 < len(short) < len(candidate.readings):
        words += f" in {len(short)} of {len(candidate.readings)} runs"
    more = f"at least {candidate.more_runs} more would decide" if candidate.verdict == "inconclusive" else ""
    return "; ".join(filter(None, (words, more)))


def answer(run: RunResult, settings: list[Candidate]) -> str:
    """Which setting over a link to take, or why none, in one sentence."""
    demand, passing = settings[0].demand, _passing(settings)
    if not passing:
        (limit, count), *_ = Counter(candidate.limit for candidate in settings).most_common()
        assert limit is not None
        alike = [candidate for candidate in settings if candidate.limit == limit]
        nearest = _nearest(alike)
        why = f"{count} of {len(settings)} settings {_GROUPS[limit][1]}, such as {nearest.name}"
        none = "passes" if all(candidate.verdict == "fails" for candidate in settings) else "is known to pass"
        return f"Nothing {none} over {demand.link}, because {why} ({limit_of(nearest)})."
    taken, sure = passing[0], passing[0].least_sure
    chance = f"passes in {sure.successes} of {sure.runs} runs (at least {100 * sure.interval[0]:.0f} % at 95 %)"
    cost = f"{_cost_words(run, taken)}{_saving(run, settings)}"
    return f"Over {demand.link} use {taken.name}: {cost}; {chance}: {_facts(taken)}."


def _saving(run: RunResult, settings: list[Candidate]) -> str:
    """`, 70 % less than the smallest jpeg that passes (quality=10, 2 Mbit/s)`."""
    anchor = next(iter(run.schema.anchors), "")
    taken = _passing(settings)[0]
    anchors = [candidate for candidate in settings if candidate.curve.split(" ")[0] == anchor]
    if run.rate is None:
        return ""
    if taken in anchors:
        others = [candidate for candidate in _passing(settings) if candidate not in anchors]
        return (
            f", {-_extra_percent(run, taken, others[0]):.0f} % less than the next codec that passes ({others[0].name})"
            if others
            else ""
        )
    if not anchors:
        return ""
    smallest = next(iter(_passing(anchors)), None)
    if smallest is None:
        return f", while no {anchor} setting tried passes"
    less = f"{-_extra_percent(run, taken, smallest):.0f} % less than the smallest {anchor} that passes"
    return f", {less} ({smallest.point}, {_cost_words(run, smallest, brief=True)})"


def _extra_percent(run: RunResult, taken: Candidate, other: Candidate) -> float:
    """The additional cost of a setting against another, in percent."""
    costs = [deciding_cost(run, setting.sequence, setting.curve, _setting(setting)) for setting in (taken, other)]
    return 100.0 * (costs[0] / costs[1] - 1.0)


def _setting(candidate: Candidate) -> Standing:
    return Standing(candidate.point, candidate.rate, 0, 0)


def _facts(taken: Candidate) -> str:
    demand, facts = taken.demand, []
    if taken.readings:
        bound = "" if demand.error_m is None else f"≤ {demand.error_m:g} m required, "
        facts.append(f"error {_number(taken.error_m)} m ({bound}{_number(taken.idle_m)} m with nothing received)")
        facts.append(f"{_FRESH} {_percent(taken.fresh)} of capture times ({_percent(FRESH_SHARE)} required)")
    if demand.deadline_ms is not None:
        facts.append(f"{_percent(taken.share)} of frames before the deadline ({_percent(demand.share)} required)")
    return ", ".join([*facts, *([] if taken.readings else ["no evaluator reads them"])])


def _cost_words(run: RunResult, candidate: Candidate, *, brief: bool = False) -> str:
    if run.rate is None:
        return "its rate is not known"
    return rate_words(run, candidate.sequence, candidate.curve, _setting(candidate), brief=brief)


def _notes(run: RunResult, settings: list[Candidate]) -> Iterator[str]:
    if run.rate is None:
        yield "No rate was measured, so settings are in the order of the matrix; add an evaluator with a rate metric."
    missing: dict[str, list[str]] = defaultdict(list)
    for candidate in settings:
        if candidate.limit == "unmeasured":
            for what in candidate.unmeasured:
                missing[what].append(candidate.name)
    readers = (result.cell.evaluator.name for result in run.results
               if any(metric.quantity == "error" for metric in result.metrics.values()))  # fmt: skip
    again = f"`codecbench run MATRIX --out {run.folder} --recompute {next(readers, '')}` measures it"
    for what, names in missing.items():
        add = "add an evaluator that measures it with the same link parameters"
        yield f"{_names_and_count(names)}: {what} was not measured; {again if what == IDLE_ERROR else add}."
