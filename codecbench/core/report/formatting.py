"""Rankings, limits and statistical power, as sentences and table rows."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from statistics import median
from typing import Final

import numpy as np

from codecbench.core.analysis.curve_values import SMALLEST
from codecbench.core.analysis.evidence import POWER, Evidence
from codecbench.core.analysis.limits import POOLED, Limit, criteria, limits, pooled_rates
from codecbench.core.analysis.passing import Test
from codecbench.core.analysis.power import LimitPower, PairPower, limit_powers, pair_powers, powers_of
from codecbench.core.analysis.ranking import NO_COMMON_RATE, SIGNIFICANCE, Ranked, Ranking, rankings
from codecbench.core.analysis.run_result import Column, RunResult, successes
from codecbench.core.engine.planning.search_section import PASSES
from codecbench.core.report.tables import three_digits

_NAMED: Final = 3
"""Sequences or pairs that a sentence names before it counts the rest."""
SURE: Final = f"{100 * (1 - SIGNIFICANCE):.0f} % confidence"
"""The confidence at which a ranking calls differences significant."""
_WIDE: Final = 50.0
"""Half width in percent points from which an interval is too asymmetric for ±."""
_LONGEST: Final = math.log(100.0)
"""Half width in log rate from which an interval is left out: a hundredth to the hundredfold of a rate."""
_FEWER: Final = 0.95
"""Share of independent frames below which their effective number is noted."""
_SMALLEST: Final = f"{100.0 * np.expm1(SMALLEST):.2g} %"


@dataclass(frozen=True)
class Verdict:
    """A title, a table (heads, rows) that may be empty, and sentences below it."""

    title: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    sentences: tuple[str, ...]
    about: Column | None = None
    """The column of a ranking."""


def compact_table(title: str, rows: Sequence[Mapping[str, str]]) -> Verdict:
    """Make a table of cells by head, in order of first appearance; a constant column becomes a sentence below.

    Missing cells are a dash; a column of dashes or without a head is left out.
    """
    heads = list(dict.fromkeys(head for row in rows for head in row if head))
    columns = {head: [row.get(head) or "–" for row in rows] for head in heads}
    constant = {head: cells[0] for head, cells in columns.items() if len(set(cells)) == 1}
    same = {head: cell for head, cell in constant.items() if len(rows) > 1 or cell == "–"}
    varying = {head: cells for head, cells in columns.items() if head not in same}
    words = ", ".join(f"{head} {cell}" for head, cell in same.items() if cell != "–")
    return Verdict(
        title, tuple(varying), tuple(zip(*varying.values(), strict=True)), (f"In all rows: {words}.",) if words else ()
    )


def curves_without_pick(failing: Sequence[str], curves: Sequence[str]) -> Iterator[str]:
    """Name the curves that have no pick: those whose settings all fail, and the others."""
    open_ = [curve for curve in curves if curve not in failing]
    for words, names in (("No setting tried passes:", failing), ("No setting is known to pass:", open_)):
        if names:
            yield f"{words} {', '.join(names)}."


def verdicts_at(run: RunResult, rate: float) -> list[Verdict]:
    """The codec to take at a rate, in the displayed unit, by each task."""
    if run.rate is None:
        return []
    return [ranked_verdict(run, ranking) for ranking in rankings(run, at=rate / run.rate.factor)]


def verdicts(run: RunResult, *, brief: bool = False) -> list[Verdict]:
    """The codec to take by each task, then the rate down to which each codec passes.

    Each begins with all sequences together if there are several; with `brief` the rest is left out.
    """
    ranked: dict[Column, list[Verdict]] = defaultdict(list)
    for ranking in rankings(run, brief=brief):
        ranked[ranking.column].append(ranked_verdict(run, ranking))
    groups = [
        *ranked.values(),
        *(list(_limit_verdicts(run, columns)) for columns in criteria(run) if columns[0].metric.role == "success"),
    ]
    return [*search_verdicts(run), *(verdict for group in groups for verdict in (group[:1] if brief else group))]


def search_verdicts(run: RunResult, *, brief: bool = False) -> Iterator[Verdict]:
    """The findings of the matrix's searches; brief: without sentences, and without searches for what passes."""
    searches = [search for search in run.plan.searches if not (brief and search.objective == PASSES)]
    if searches:
        heads = ("codec", "sequence", "objective", "state", "setting", "value")
        rows = tuple(
            (search.codec, search.sequence, search.objective, search.state, search.setting or "–",
             "–" if search.reached is None else f"{search.reached:.4g}")
            for search in searches
        )  # fmt: skip
        yield Verdict("searches", heads, rows, () if brief else tuple(f"{search}." for search in searches))


def ranked_verdict(run: RunResult, ranking: Ranking) -> Verdict:
    """The codec to take, what is undecided and what would decide it, below a row for each codec."""
    title = f"{sequence_words(ranking.sequence)}: {ranking.column.label}"
    if not ranking.ranked:
        reason = ranking.uninformative.get(ranking.sequence)
        reasons = uninformative_notes(ranking) if reason is None else [f"Uninformative here: {reason}."]
        return Verdict(title, (), (), tuple(reasons), ranking.column)
    title += f", {ranking.units} {' and '.join(ranking.of)}"
    cells: dict[str, Callable[[Ranked], str]] = {}
    if ranking.rate is not None:
        title += f", at {_rate_words(run, ranking.rate)}"
        cells[ranking.column.heading] = partial(_value, ranking.column)
        cells["setting"] = lambda ranked: setting_words(ranked.settings) or "–"
    for anchor in ranking.anchors:
        cells[f"rate vs. {anchor}"] = partial(_rate_against, ranking, anchor)
    rows = tuple(
        (ranked.curve, *(cell(ranked) for cell in cells.values()),
         ", ".join(f"{other} ({_rate_against(ranking, other, ranked)})" for other in ranked.ahead_of) or "–")
        for ranked in ranking.ranked
    )  # fmt: skip
    heads = ("codec", *cells, "significantly better than")
    return Verdict(
        title, heads, rows, (_recommendation(run, ranking), *_remedies(ranking), *_notes(ranking)), ranking.column
    )


def signed_percent(evidence: Evidence, other: str = "") -> str:
    """`-28 % ± 3 vs. jpeg`: the additional rate of the first of two curves for equal quality, ± half the 95 % interval.

    `≤ -6 %` if the difference is a bound.
    """
    number, margin, interval = _percent(evidence)
    bound = "" if not evidence.at_least else "≤ " if evidence.mean > 0.0 else "≥ "
    return f"{bound}{number} %{margin}{other and f' vs. {other}'}{interval and f', {interval}'}"


def less_rate(evidence: Evidence, other: str) -> str:
    """`28 % ± 3 less rate than jpeg`, for the first of two curves."""
    number, margin, interval = _percent(evidence)
    words = f"{number.lstrip('+-')} %{margin} {'less' if evidence.mean > 0.0 else 'more'} rate than {other}"
    return f"{'at least ' if evidence.at_least else ''}{words}{interval and f' ({interval})'}"


def _percent(evidence: Evidence) -> tuple[str, str, str]:
    """The difference in rate, half the width of its interval in percent points, or the interval if it is wide."""
    middle, reach = 100.0 * math.expm1(-evidence.mean), evidence.reach(0.95)
    if reach > _LONGEST:
        return format_percent(middle), "", "" if evidence.at_least else "no interval"
    low, high = (100.0 * math.expm1(move - evidence.mean) for move in (-reach, reach))
    half = 0.5 * (high - low)
    if half > _WIDE:
        return format_percent(middle), "", f"{format_percent(low)} to {format_percent(high)} %"
    digits = 0 if half >= 0.95 or half == 0.0 else min(3, math.ceil(-math.log10(half)))
    return f"{middle:+.{digits}f}", f" ± {half:.{digits}f}", ""


def format_percent(percent: float) -> str:
    """Format a change in percent with its sign, in three digits at most."""
    return "0" if abs(percent) < 0.5 else f"{float(f'{percent:.3g}'):+.0f}"


def _rate_against(ranking: Ranking, other: str, ranked: Ranked) -> str:
    evidence = ranking.evidence(ranked.curve, other)
    return "–" if evidence is None else signed_percent(evidence)


def _recommendation(run: RunResult, ranking: Ranking) -> str:
    """`At 0.2 bit/px take avif (quality 40–55): 28 % ± 3 less rate than jpeg.`"""
    at = "Over all rates" if ranking.rate is None else f"At {_rate_words(run, ranking.rate)}"
    taken, others = ranking.recommended, ranking.as_good
    settings = setting_words(taken.settings)
    known = ((ranking.evidence(taken.curve, anchor), anchor) for anchor in ranking.anchors if anchor not in others)
    than = ", ".join(less_rate(evidence, anchor) for evidence, anchor in known if evidence is not None)
    words = f"{at} take {taken.curve}{settings and f' ({settings})'}{than and f': {than}'}"
    is_open = len(others) + 1 == len(ranking.ranked)
    if others:
        words += f"{';' if than else ','} or {'any other' if is_open and len(others) > 1 else ', '.join(others)}"
    if ranking.too_few:
        return f"{words}: too few {' and '.join(ranking.of)} for a test."
    undecided = is_open and not any(ranked.ahead_of for ranked in ranking.ranked)
    return f"{words}: no significant difference ({SURE})." if undecided else f"{words}."


def _rate_words(run: RunResult, rate: float) -> str:
    assert run.rate is not None
    return f"{three_digits(rate * run.rate.factor)} {run.rate.unit}"


def _value(column: Column, ranked: Ranked) -> str:
    return "–" if ranked.value is None else f"{ranked.value * column.factor:.4g}"


def setting_words(by_sequence: Mapping[str, tuple[str, ...]]) -> str:
    """`quality 40–55`: the range of settings over all sequences; empty for a codec whose only setting has no name."""
    low, high = _ends([point for points in by_sequence.values() for point in points])
    words = (
        low
        if low in (high, f"{low.rpartition(' ')[0]} {high}")
        else f"{low}{'–' if high[0].isdigit() else ' to '}{high}"
    )
    return f"{words}, depending on the sequence" if len(set(by_sequence.values())) > 1 else words


def _ends(points: Sequence[str]) -> tuple[str, str]:
    """(`quality 40`, `55`): least and largest value of names such as `quality=55`, or the first and the last name."""
    names, values = (list({point.rpartition("=")[at]: None for point in points}) for at in (0, 2))
    if len(names) == 1:
        with suppress(ValueError):
            return f"{names[0]} {min(values, key=float)}".replace("=", " "), max(values, key=float)
    return points[0].replace("=", " "), points[-1].replace("=", " ")


def _remedies(ranking: Ranking) -> Iterator[str]:
    """Say what would decide between the codec to take and others that may be the best; count other pairs."""
    taken = ranking.recommended.curve
    open_pairs: dict[frozenset[str], PairPower] = {}
    for pair in powers_of(ranking):
        if pair.remedy.kind == "equal":
            yield f"{pair.first} and {pair.second} are equal within {_SMALLEST} of rate."
        elif pair.remedy.kind != "decided":
            open_pairs[frozenset((pair.first, pair.second))] = pair
    if ranking.too_few:
        return
    for name in ranking.as_good:
        evidence, with_taken = ranking.evidence(name, taken), open_pairs.pop(frozenset((name, taken)), None)
        if evidence and with_taken:
            yield f"{name}: inconclusive ({signed_percent(evidence, taken)}); would decide: {remedy_words(with_taken)}."
    if open_pairs:
        pairs = "other pair is" if len(open_pairs) == 1 else "other pairs are"
        yield f"{len(open_pairs)} {pairs} inconclusive: `codecbench power` shows what would decide."


def remedy_words(pair: PairPower) -> str:
    """What would decide a pair of curves."""
    remedy, of = pair.remedy, " and ".join(pair.of)
    if remedy.gap is not None:
        return f"more settings of {remedy.gap.curve} between {' and '.join(_ends(remedy.gap.points))}"
    if remedy.kind == "samples":
        like = " like these" if pair.of == ("frames",) and remedy.more else ""
        about = "" if remedy.more is None else f"about {_two_digits(remedy.more)} "
        return f"{about}more {of.removesuffix('s') if remedy.more == 1 else of}{like}"
    return {
        "decided": "–",
        "equal": "nothing",
        "small": f"nothing: less than {_SMALLEST} is negligible",
        "sequences": "more sequences, because these disagree",
        "beyond": f"not even a hundred times the {of}",
    }[remedy.kind]


def _two_digits(count: float) -> str:
    return f"{float(f'{count:.2g}'):.0f}"


def _notes(ranking: Ranking) -> Iterator[str]:
    yield from _missing_comparisons(ranking)
    yield from uninformative_notes(ranking)
    if ranking.too_few_on:
        yield f"{sequences_are_samples(ranking)}."
    worth = [evidence.worth for *_, evidence in ranking.pairs if evidence.worth < _FEWER * ranking.units]
    if worth and "frames" in ranking.of and not ranking.too_few_on:
        yield f"{ranking.units} frames count as about {_two_digits(median(worth))} independent ones."
    drifting = [f"{first} and {second}" for first, second, evidence in ranking.pairs if evidence.drifts]
    if drifting:
        more = f" and {len(drifting) - _NAMED} more" if len(drifting) > _NAMED else ""
        pairs = f"{'; '.join(drifting[:_NAMED])}{more}"
        yield f"These differences drift over the whole sequence, so their errors may be larger: {pairs}."
    if correlation := ranking.rank_correlation:
        least = min(correlation, key=lambda name: correlation[name])
        yield (
            "Leave-one-sequence-out rank agreement (Kendall's tau): "
            f"{sum(correlation.values()) / len(correlation):.2f} on average, {correlation[least]:.2f} on {least}."
        )
    for ranked in ranking.ranked:
        if ranked.missing:
            yield f"{ranked.curve}: {ranked.missing} of {ranked.values} values are missing; each counts as the worst."
    for curve, reason in ranking.left_out.items():
        yield f"{curve} is not ranked: {reason}."


def uninformative_notes(ranking: Ranking) -> Iterator[str]:
    """Say on which sequences the column ranks no codec, and why: a sentence each."""
    for sequence, reason in ranking.uninformative.items():
        yield f"{sequence}: {ranking.column.label} is uninformative here: {reason}."


def sequences_are_samples(ranking: Ranking) -> str:
    """Say why sequences are the samples of a ranking over several."""
    few, of = ranking.too_few_on, " and ".join(ranking.of)
    if len(few) == len(ranking.sequences):
        who = "each sequence has"
    elif len(few) > _NAMED:
        who = f"{len(few)} sequences have"
    else:
        who = f"{' and '.join(few)} {'has' if len(few) == 1 else 'have'}"
    return f"The sequences are the samples, because {who} too few {of} for a standard error"


def _missing_comparisons(ranking: Ranking) -> Iterator[str]:
    """Name the codecs that share no rate, each pair once."""
    seen: set[str] = set()
    for ranked in ranking.ranked:
        if others := [name for name in ranking.without_common_rate(ranked.curve) if name not in seen]:
            yield f"{ranked.curve} was not compared with {', '.join(others)}: {NO_COMMON_RATE}."
        seen.add(ranked.curve)


def sequence_words(sequence: str) -> str:
    return "all sequences together" if sequence == POOLED else sequence


def _limit_verdicts(run: RunResult, columns: list[Column]) -> Iterator[Verdict]:
    """One verdict for all sequences together, if there are several, and one for each: a sentence for each curve."""
    by_sequence: dict[str, dict[str, Limit]] = defaultdict(dict)
    for (sequence, curve), limit in limits(run, columns).items():
        by_sequence[sequence][curve] = limit
    what = " and ".join(column.label for column in columns)
    for sequence, of_curves in sorted(by_sequence.items(), key=lambda pair: pair[0] != POOLED):
        by_rate = sorted(of_curves.items(), key=lambda pair: pair[1].rate)
        sentences = [_curve_sentence(run, sequence, curve, limit) for curve, limit in by_rate]
        yield Verdict(f"{sequence_words(sequence)}: {what}", (), (), tuple(sentences))


def _curve_sentence(run: RunResult, sequence: str, curve: str, limit: Limit) -> str:
    if limit.settings and curve.split(" ")[0] in run.schema.baselines:
        return f"{curve} itself: {limit.settings[0]}."
    return limit_sentence(run, sequence, curve, limit)


def limit_sentence(run: RunResult, sequence: str, curve: str, limit: Limit) -> str:
    """`jpeg quality=10 passes at 1/87 of raw's rate (5/5 runs, at least 57 % at 95 %); quality=5 fails (...)`."""
    if limit.reason or not limit.settings:
        return f"{curve}: {limit.reason or 'no run'}."
    if limit.lowest is not None:
        share = share_of_rate(run, sequence, limit.lowest.rate)
        return f"{setting_name(curve, limit.lowest)} passes at {share} ({limit.lowest}); {limit.after_words()}."
    none = "passes at no setting" if limit.settings[0].verdict == "fails" else "is not known to pass at any setting"
    return f"{curve} {none}: {limit.after_words()}."


def setting_name(curve: str, test: Test) -> str:
    """The codec and the setting's own name, if the setting has one."""
    return f"{curve} {test.point}".strip() if not curve.endswith(f" {test.point}") else curve


def share_of_rate(run: RunResult, sequence: str, rate: float) -> str:
    """A rate on a sequence, or on all (POOLED), against the baseline's: `1/87 of raw's rate, 0.28 bit/px`."""
    words, raw = _rate_words(run, rate), baseline_rate(run, sequence)
    return words if raw is None or rate <= 0 or raw[1] <= rate else f"1/{raw[1] / rate:.0f} of {raw[0]}'s rate, {words}"


def baseline_rate(run: RunResult, sequence: str) -> tuple[str, float] | None:
    """The name and the rate of the baseline on a sequence, or on all (POOLED); None if unknown."""
    rates = pooled_rates(run) if sequence == POOLED else run.rates
    raw = [
        (codec, rate)
        for (on, codec, _), rate in rates.items()
        if on == sequence and codec in run.schema.baselines and not np.isnan(rate)
    ]
    return raw[0] if raw else None


_PAIR_HEADS = ("codecs", "difference", "smallest detectable", "verdict", "would decide")
_LIMIT_HEADS = ("setting", "successful runs", "detectable rate", "verdict", "would decide")


def power_verdicts(run: RunResult, power: float = POWER) -> list[Verdict]:
    """A table of the pairs of each ranking, and one of the settings for each sequence and success."""
    pairs = groupby(pair_powers(run, power), key=lambda pair: (pair.column.name, pair.sequence))
    tables = [_pairs_table(list(members)) for _, members in pairs]
    for columns in successes(run):
        powers = sorted(limit_powers(run, columns, power), key=lambda limit: limit.sequence)
        tables += [_limits_table(list(members)) for _, members in groupby(powers, key=lambda limit: limit.sequence)]
    return tables


def _pairs_table(pairs: list[PairPower]) -> Verdict:
    first = pairs[0]
    of = " and ".join(first.of)
    title = f"{sequence_words(first.sequence)}: {first.column.label}, {first.units} {of}, {_power_words(first.power)}"
    rows = tuple(
        (
            f"{pair.first} vs. {pair.second}",
            signed_percent(pair.evidence),
            f"{-100.0 * math.expm1(-pair.smallest):.3g} %" if pair.smallest < _LONGEST else "–",
            _outcome(pair),
            remedy_words(pair),
        )
        for pair in pairs
    )
    stood = sum(pair.stands for pair in pairs)
    sentences = [f"{stood} of {len(pairs)} differences are significant at {first.level:.2g}, 0.01 over all pairs."]
    return Verdict(title, _PAIR_HEADS, rows, tuple(sentences))


def _power_words(power: float) -> str:
    return f"power {100.0 * power:.3g} %"


def _outcome(pair: PairPower) -> str:
    if pair.stands:
        return f"{pair.first if pair.difference > 0 else pair.second} is significantly better"
    return f"equal within {_SMALLEST}" if pair.remedy.kind == "equal" else "inconclusive"


def _limits_table(powers: list[LimitPower]) -> Verdict:
    first = powers[0]
    label = " and ".join(column.label for column in first.columns)
    title = f"{sequence_words(first.sequence)}: {label}, {_power_words(first.power)}"
    rows = tuple(
        (
            f"{limit.curve} {limit.standing.point}".strip(),
            f"{limit.standing.successes}/{limit.standing.runs}",
            "–" if math.isnan(limit.detectable_rate) else f"{100 * limit.detectable_rate:.0f} %",
            limit.standing.verdict,
            "–" if limit.more_runs == 0 else f"at least {limit.more_runs} more runs",
        )
        for limit in powers
    )
    stood = sum(limit.more_runs == 0 for limit in powers)
    return Verdict(title, _LIMIT_HEADS, rows, (f"{stood} of {len(powers)} verdicts are conclusive at 95 %.",))
