"""A ranking, and what holds at which rate, as sentences and rows for people."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Final

import numpy as np

from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.curve_values import SMALLEST
from codecbench.core.analysis.evidence import POWER
from codecbench.core.analysis.limits import POOLED, Limit, limits, pooled_rates
from codecbench.core.analysis.power import LimitPower, PairPower, limit_powers, pair_powers
from codecbench.core.analysis.ranking import NO_COMMON_RATE, SIGNIFICANCE, Ranked, Ranking, rankings
from codecbench.core.analysis.run_result import RunResult, successes
from codecbench.core.analysis.verdicts import SequenceCurve
from codecbench.core.report.tables import three_digits

_NAMED: Final = 3
"""So many sequences are named, and more are counted."""
SURE: Final = f"{100 * (1 - SIGNIFICANCE):.0f} % confidence"
"""How sure a ranking is of whom it puts before whom."""


@dataclass(frozen=True)
class Verdict:
    """A title, a table (heads, rows) that may be empty, and sentences below it. about: the column that is ranked."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    sentences: tuple[str, ...]
    about: Column | None = None


def verdicts_at(run: RunResult, rate: float) -> list[Verdict]:
    """Which codec to take at a rate, in the unit that people are shown, by each task."""
    if run.rate is None:
        return []
    return [_ranked(run, ranking) for ranking in rankings(run, at=rate / run.rate.factor)]


def verdicts(run: RunResult, *, brief: bool = False) -> list[Verdict]:
    """What the run decides: who is ahead by each task, then down to which rate each codec holds.

    Each begins with all sequences together, where there are several; with `brief` that is all.
    """
    ranked: dict[Column, list[Verdict]] = defaultdict(list)
    for ranking in rankings(run, brief=brief):
        ranked[ranking.column].append(_ranked(run, ranking))
    groups = [*ranked.values(), *(list(_held(run, columns)) for columns in successes(run))]
    return [*_found(run), *(verdict for group in groups for verdict in (group[:1] if brief else group))]


def _found(run: RunResult) -> Iterator[Verdict]:
    """What the searches of the matrix have found."""
    if run.plan.searches:
        heads = ("codec", "sequence", "sought", "", "setting", "has")
        rows = tuple(
            (found.codec, found.sequence, found.aim, found.state, found.setting or "–",
             "–" if found.reached is None else f"{found.reached:.4g}")
            for found in run.plan.searches
        )  # fmt: skip
        yield Verdict("searches", heads, rows, tuple(f"{found}." for found in run.plan.searches))


def _ranked(run: RunResult, ranking: Ranking) -> Verdict:
    title = f"{where(ranking.sequence)}: {ranking.column.label}"
    if not ranking.ranked:
        own = ranking.uninformative.get(ranking.sequence)
        said = uninformative(ranking) if own is None else [f"Uninformative here: {own}."]
        return Verdict(title, (), (), tuple(said), ranking.column)
    title += f", {ranking.units} {' and '.join(ranking.of)}"
    if ranking.rate is None:
        heads = [(f"rate beside {anchor}", anchor) for anchor in ranking.anchors] or [("rate", "")]
        shown: dict[str, Callable[[Ranked], str]] = {head: partial(_rate, anchor) for head, anchor in heads}
    else:
        title += f", at {_spent(run, ranking.rate)}"
        shown = {ranking.column.heading: partial(_value, ranking.column), "setting": setting_words}
    named = ("place", "codec", "group", *shown, "better than")
    rows = tuple(
        (_places(ranked), ranked.curve, ranked.group, *(cell(ranked) for cell in shown.values()),
         ", ".join(_ahead_of(ranking, ranked.curve, other) for other in ranked.ahead_of) or "–")
        for ranked in ranking.ranked
    )  # fmt: skip
    taken = () if ranking.rate is None else (_taken(run, ranking),)
    return Verdict(title, named, rows, (*taken, *_notes(ranking)), ranking.column)


def _ahead_of(ranking: Ranking, first: str, second: str) -> str:
    """`jpeg (31 % less rate, 25 to 36)`: the rate that the first saves for the same quality, with its 95 % interval."""
    found = ranking.evidence(first, second)
    if found is None:
        return second
    reach = found.reach(0.95)
    saved = [100.0 * (1.0 - np.exp(-value)) for value in (found.mean, found.mean - reach, found.mean + reach)]
    return f"{second} ({saved[0]:.2g} % less rate, {saved[1]:.2g} to {saved[2]:.2g})"


def _taken(run: RunResult, ranking: Ranking) -> str:
    """Which codec to take at the ranking's rate, and how sure that is."""
    assert ranking.rate is not None
    taken = ranking.recommended
    setting = setting_words(taken)
    parts = [f"At {_spent(run, ranking.rate)} take {taken.curve}{'' if setting == '–' else f' {setting}'}"]
    if ranking.as_good:
        parts[0] += f", or {', '.join(ranking.as_good)}, which cannot be told from it"
    if taken.ahead_of:
        every = len(taken.ahead_of) + 1 == len(ranking.ranked)
        parts.append(f"it is better than {'every other: ' if every else ''}{', '.join(taken.ahead_of)}")
    behind = [each.curve for each in ranking.ranked if each.first > 1 and each.curve not in taken.ahead_of]
    if behind:
        parts.append(f"others are better than {', '.join(behind)}")
    return "; ".join(parts) + "."


def _spent(run: RunResult, rate: float) -> str:
    assert run.rate is not None
    return f"{three_digits(rate * run.rate.factor)} {run.rate.unit}"


def _value(column: Column, ranked: Ranked) -> str:
    return "–" if ranked.value is None else f"{ranked.value * column.factor:.4g}"


def setting_words(ranked: Ranked) -> str:
    """The setting at the ranking's rate, or the two between which it lies; by sequence if they differ."""
    by_words: dict[str, list[str]] = defaultdict(list)
    for sequence, points in ranked.settings.items():
        by_words[f"between {' and '.join(points)}" if len(points) > 1 else points[0]].append(sequence)
    if len(by_words) > 1:
        return "; ".join(f"{words} on {', '.join(sequences)}" for words, sequences in by_words.items())
    return next(iter(by_words), "") or "–"


def _places(ranked: Ranked) -> str:
    return str(ranked.first) if ranked.first == ranked.last else f"{ranked.first}–{ranked.last}"


def _rate(anchor: str, ranked: Ranked) -> str:
    rate = ranked.bd_rates.get(anchor)
    return "–" if rate is None or rate.reason else f"{rate.percent:+.0f} %"


def _notes(ranking: Ranking) -> Iterator[str]:
    if not any(ranked.ahead_of for ranked in ranking.ranked):
        few = f": so few {' and '.join(ranking.of)} cannot tell" if ranking.too_few else ""
        yield f"No two of these codecs can be told apart with {SURE}{few}."
    else:
        yield "Codecs that share a letter cannot be told apart."
    for first, second in ranking.equal:
        yield f"{first} and {second} are equal within {100.0 * np.expm1(SMALLEST):.2g} % of rate."
    yield from _not_compared(ranking)
    yield from uninformative(ranking)
    if ranking.too_few_on:
        yield f"{sequences_are_samples(ranking)}."
    if ranking.rank_correlation:
        least = min(ranking.rank_correlation, key=lambda name: ranking.rank_correlation[name])
        mean = sum(ranking.rank_correlation.values()) / len(ranking.rank_correlation)
        yield (
            f"The order on a sequence is foretold by the others' with Kendall's tau {mean:.2f} on average, "
            f"{ranking.rank_correlation[least]:.2f} on {least}."
        )
    for ranked in ranking.ranked:
        if ranked.missing:
            yield f"{ranked.curve}: {ranked.missing} of {ranked.values} values are missing; each counts as the worst."
    for curve, reason in ranking.left_out.items():
        yield f"{curve} has no place: {reason}."


def uninformative(ranking: Ranking) -> Iterator[str]:
    """On which sequences the column ranks nobody, and why: a sentence each."""
    for sequence, reason in ranking.uninformative.items():
        yield f"{sequence}: {ranking.column.label} is uninformative here: {reason}."


def sequences_are_samples(ranking: Ranking) -> str:
    """Why a ranking over several sequences is less sure than those of each."""
    few, of = ranking.too_few_on, " and ".join(ranking.of)
    if len(few) == len(ranking.rank_correlation):
        who = "each sequence has"
    elif len(few) > _NAMED:
        who = f"{len(few)} sequences have"
    else:
        who = f"{' and '.join(few)} {'has' if len(few) == 1 else 'have'}"
    return f"The sequences are the samples, as {who} too few {of} to say how sure"


def beside_ranking(ranking: Ranking, first: str, second: str) -> str:
    """Why a ranking does not put one of two curves before the other, though other figures do; empty where it does."""
    if reason := ranking.uninformative.get(ranking.sequence):
        return f"uninformative here: {reason}"
    places = {ranked.curve: ranked for ranked in ranking.ranked}
    if first not in places or second not in places:
        return ""
    if second in places[first].ahead_of or first in places[second].ahead_of:
        return ""
    if second in ranking.not_compared(first):
        return f"the ranking does not compare them: {NO_COMMON_RATE}"
    if ranking.too_few:
        return f"so few {' and '.join(ranking.of)} cannot tell them apart in the ranking"
    return f"not told apart in the ranking, which asks for {SURE} over all pairs together"


def _not_compared(ranking: Ranking) -> Iterator[str]:
    """Who shares no rate with whom, each pair once."""
    said: set[str] = set()
    for ranked in ranking.ranked:
        if others := [name for name in ranking.not_compared(ranked.curve) if name not in said]:
            yield f"{ranked.curve} was not compared with {', '.join(others)}: {NO_COMMON_RATE}."
        said.add(ranked.curve)
    for anchor in ranking.anchors:
        if any(_rate(anchor, each) != "–" for each in ranking.ranked if anchor in ranking.not_compared(each.curve)):
            yield f"The rate beside {anchor} is for equal values, which codecs may reach without a common rate."


def where(sequence: str) -> str:
    return "all sequences together" if sequence == POOLED else sequence


def _held(run: RunResult, columns: list[Column]) -> Iterator[Verdict]:
    """One verdict for all sequences together, where there are several, and one for each: a sentence for each curve."""
    by_sequence: dict[str, dict[str, Limit]] = defaultdict(dict)
    found: dict[SequenceCurve, Limit] = limits(run, columns)
    for (sequence, curve), limit in found.items():
        by_sequence[sequence][curve] = limit
    what = " and ".join(column.label for column in columns)
    for sequence, of_curves in sorted(by_sequence.items(), key=lambda pair: pair[0] != POOLED):
        sentences = [_sentence(run, sequence, curve, limit) for curve, limit in _by_rate(of_curves)]
        yield Verdict(f"{where(sequence)}: {what}", (), (), tuple(sentences))


def _by_rate(limits_of_curves: dict[str, Limit]) -> list[tuple[str, Limit]]:
    return sorted(limits_of_curves.items(), key=lambda pair: pair[1].rate)


def _sentence(run: RunResult, sequence: str, curve: str, limit: Limit) -> str:
    """`jpeg quality=10 holds at 1/87 of raw's rate (0.28 bit/px, 5/5 runs, at least 57 % at 95 %); quality=5 fails`."""
    if limit.settings and curve.split(" ")[0] in run.schema.baselines:
        return f"{curve} itself: {limit.settings[0]}."
    if limit.lowest is None or run.rate is None:
        return f"{curve}: {limit_words(limit, run.rate)}."
    standing = limit.lowest
    words = f"{f'{curve} {standing.point}'.strip()} holds at {share_of_rate(run, sequence, standing.rate)} ({standing})"
    return f"{words}; {limit.after_words()}."


def share_of_rate(run: RunResult, sequence: str, rate: float) -> str:
    """A rate on a sequence, or on all (POOLED), beside the baseline's: `1/87 of raw's rate, 0.28 bit/px`."""
    spent, raw = _spent(run, rate), baseline_rate(run, sequence)
    return spent if raw is None or rate <= 0 or raw[1] <= rate else f"1/{raw[1] / rate:.0f} of {raw[0]}'s rate, {spent}"


def baseline_rate(run: RunResult, sequence: str) -> tuple[str, float] | None:
    """The name and the rate of the baseline on a sequence, or on all (POOLED); None where it is not known."""
    rates = pooled_rates(run) if sequence == POOLED else run.rates
    raw = [
        (codec, rate)
        for (on, codec, _), rate in rates.items()
        if on == sequence and codec in run.schema.baselines and not np.isnan(rate)
    ]
    return raw[0] if raw else None


_PAIR_HEADS = ("codecs", "difference", "smallest shown", "says", "would tell")
_LIMIT_HEADS = ("setting", "runs that succeed", "told from", "says", "would tell")


def power_verdicts(run: RunResult, power: float = POWER) -> list[Verdict]:
    """A table for each ranking, of its pairs, and one for each sequence and success, of its settings."""
    pairs = groupby(pair_powers(run, power), key=lambda pair: (pair.column.name, pair.sequence))
    found = [_of_pairs(list(members)) for _, members in pairs]
    for columns in successes(run):
        powers = sorted(limit_powers(run, columns, power), key=lambda limit: limit.sequence)
        found += [_of_limits(list(members)) for _, members in groupby(powers, key=lambda limit: limit.sequence)]
    return found


def _of_pairs(pairs: list[PairPower]) -> Verdict:
    first = pairs[0]
    of = " and ".join(first.of)
    title = f"{where(first.sequence)}: {first.column.label}, {first.units} {of}, found {_often(first.power)}"
    rows = tuple(
        (
            f"{pair.first} over {pair.second}",
            _amount(pair.difference),
            "–" if math.isnan(pair.smallest) else _amount(pair.smallest),
            _said(pair),
            _more(pair.more_units, of),
        )
        for pair in pairs
    )
    stood = sum(pair.stands for pair in pairs)
    sentences = [f"{stood} of {len(pairs)} differences stand at {first.level:.2g}, a share of 0.01 for each pair."]
    return Verdict(title, _PAIR_HEADS, rows, tuple(sentences))


def _often(power: float) -> str:
    return f"in {100.0 * power:.3g} % of cases"


def _amount(difference: float) -> str:
    """How much more (+) or less rate the first takes for the same quality."""
    return f"{100.0 * math.expm1(-difference):+.3g} %"


def _said(pair: PairPower) -> str:
    if pair.stands:
        return f"{pair.first if pair.difference > 0 else pair.second} is ahead"
    return "the same everywhere" if pair.difference == 0.0 and pair.evidence.variance == 0.0 else "cannot tell"


def _more(more: int | None, of: str) -> str:
    if more == 0:
        return "–"
    return f"more than a thousandfold {of}" if more is None else f"{more} more {of}"


def _of_limits(found: list[LimitPower]) -> Verdict:
    first = found[0]
    label = " and ".join(column.label for column in first.columns)
    title = f"{where(first.sequence)}: {label}, found {_often(first.power)}"
    rows = tuple(
        (
            f"{limit.curve} {limit.standing.point}".strip(),
            f"{limit.standing.successes}/{limit.standing.runs}",
            "–" if math.isnan(limit.told_from) else f"{100 * limit.told_from:.0f} %",
            limit.standing.verdict,
            "–" if limit.more_runs == 0 else f"{limit.more_runs} more runs at best",
        )
        for limit in found
    )
    stood = sum(limit.more_runs == 0 for limit in found)
    return Verdict(title, _LIMIT_HEADS, rows, (f"{stood} of {len(found)} verdicts stand at 95 %.",))


def limit_words(limit: Limit, rate: Column | None) -> str:
    """Where a limit lies, and what comes after it."""
    if limit.reason or rate is None:
        return limit.reason
    if limit.lowest is None:
        return limit.after_words()
    spent = f"{three_digits(limit.lowest.rate * rate.factor)} {rate.unit}"
    return f"{limit.lowest.point or 'its setting'} ({spent}, {limit.lowest}); {limit.after_words()}"
