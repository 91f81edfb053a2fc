"""Codecs in order of the rate at which they serve a task equally well, as far as a run can tell them apart."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.curve_values import SMALLEST, Array, CurveValues, Of, curve_values, difference, objection
from codecbench.core.analysis.evidence import Evidence, combined
from codecbench.core.analysis.limits import POOLED
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.verdicts import anchors_of, from_quality

SIGNIFICANCE: Final = 0.01
"""Chance that a ranking of codecs that are all alike puts any of them before another."""

_OF_A_BOUND: Final = 1e-3
"""What a bound weighs in scores: it counts only for codecs that no other pair connects."""
NO_COMMON_RATE: Final = "no common rate to compare at"
"""Why two codecs that both have a place are not compared with each other."""


@dataclass(frozen=True)
class Ranked:
    """A codec's place. first, last: the places that it may have, from those that differ significantly from it.

    ahead_of: the curves that it is significantly better than. missing, values: how many of its values are missing, of
    how many. score: how much better it is than the others on average, as the log of a rate, by least squares over
    pairs. settings: by sequence, names in order of rate; all, or in a ranking at one rate the one that has this rate or
    the two around it. value: the column's mean at that rate, between settings; None in a ranking over all rates.
    """

    curve: str
    first: int
    last: int
    ahead_of: tuple[str, ...]
    missing: int
    values: int
    score: float
    settings: Mapping[str, tuple[str, ...]]
    value: float | None = None


@dataclass(frozen=True)
class Gap:
    """Two neighboring settings of a curve between which more would narrow the interval of a difference."""

    curve: str
    points: tuple[str, str]


@dataclass(frozen=True)
class Ranking:
    """Codecs by a column on a sequence, or over all of them (POOLED), compared over so many frames or repeats.

    ranked: by value at the rate; over all rates by the rate vs. the first anchor, and where the two share none, by
    score. left_out: curves without a place, and why. sequences: all that count. anchors: the curves that rates are
    shown against. rate: at which codecs are compared; None for all rates that they share. pairs: of two curves that
    share a rate, what is known of the first over the second. rank_correlation: by sequence, Kendall's tau-b of the
    order there and that of all other sequences together, if both have a significant difference. too_few_on: of several
    sequences those that have too few frames or repeats to say how sure they are, so that sequences are the samples.
    gaps: of pairs whose settings are too far apart, so that this doubt is half of their difference or more, the widest
    gap. disputed: pairs of which each is significantly better on some sequence. uninformative: by sequence, why the
    column ranks no codec there.
    """

    column: Column
    sequence: str
    units: int
    of: tuple[Of, ...]
    ranked: tuple[Ranked, ...]
    left_out: dict[str, str]
    sequences: tuple[str, ...]
    anchors: tuple[str, ...]
    rate: float | None
    pairs: tuple[tuple[str, str, Evidence], ...]
    rank_correlation: dict[str, float]
    too_few_on: tuple[str, ...] = ()
    gaps: Mapping[tuple[str, str], Gap] = field(default_factory=dict)
    disputed: tuple[tuple[str, str], ...] = ()
    uninformative: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def candidates(self) -> tuple[Ranked, ...]:
        """The codecs that may be the best, by score; in a circle the one with the highest score.

        The others are ruled out: by multiple comparisons with the best (Hsu 1984, doi:10.1214/aos/1176346732), with
        Bonferroni's level in place of Dunnett's, as pairs depend on each other in unknown ways, or by `ahead_of`.
        """
        no_better: dict[str, list[float]] = defaultdict(list)  # one-sided p-values of those that seem better
        for first, second, found in self.pairs:
            chance = found.p_beyond(SMALLEST) / 2.0
            no_better[first].append(chance if found.mean < 0.0 else 1.0)
            no_better[second].append(chance if found.mean > 0.0 else 1.0)
        order = sorted(self.ranked, key=lambda ranked: -ranked.score)
        return tuple(
            ranked for ranked in order
            if ranked.first == 1 and all(p >= SIGNIFICANCE / len(ps) for ps in [no_better[ranked.curve]] for p in ps)
        ) or tuple(order[:1])  # fmt: skip

    @property
    def recommended(self) -> Ranked:
        """The codec to take: of those that may be the best the highest score.

        Raises ValueError if no codec is ranked, as the column is uninformative.
        """
        return max(self.candidates, key=lambda ranked: ranked.score)

    @property
    def as_good(self) -> tuple[str, ...]:
        """Other curves that may be the best."""
        return tuple(each.curve for each in self.candidates[1:])

    def evidence(self, first: str, second: str) -> Evidence | None:
        """What is known of two curves: the log of how many times the first one's rate the second takes."""
        for one, other, found in self.pairs:
            if (one, other) == (first, second):
                return found
            if (other, one) == (first, second):
                return replace(found, mean=-found.mean)
        return None

    def not_compared(self, curve: str) -> tuple[str, ...]:
        """The ranked curves that share no rate with this one, of which nothing is known beside it."""
        compared = {name for first, second, _ in self.pairs if curve in (first, second) for name in (first, second)}
        return tuple(each.curve for each in self.ranked if each.curve != curve and each.curve not in compared)

    @property
    def too_few(self) -> bool:
        """Whether so few frames or repeats cannot tell of any two codecs, however far apart they are."""
        return _too_few(evidence for _, _, evidence in self.pairs)


def rankings(run: RunResult, *, brief: bool = False, at: float | None = None) -> list[Ranking]:
    """Rankings by every headline of role `task`, or else `quality`: over all sequences first, then on each.

    A ranking over all of a single sequence is left out, as are those that would have less than two codecs, unless the
    column is uninformative, which they say instead. Nothing if the run has no rate. brief: only the first of each
    column. at: the rate, in its metric's unit, at which codecs are compared, between the logarithms of their settings'
    rates; all rates that two codecs share, without it.
    """
    run = run.as_calibrated
    columns = [c for c in run.headlines("task") or run.headlines("quality")[:1] if c.metric.better != "neither"]
    sequences = [entry.name for entry in run.plan.sequences]
    groups = [sequences] if len(sequences) > 1 else []
    groups += [] if groups and brief else [[name] for name in sequences]
    return [
        ranking
        for column in columns
        for ranking in rankings_on(run, column, groups, at)
        if len(ranking.ranked) > 1 or not ranking.sequences
    ]


def rankings_on(
    run: RunResult, column: Column, groups: Sequence[Sequence[str]], at: float | None = None
) -> Iterator[Ranking]:
    """The ranking by a column over each group of sequences, whatever it compares. Nothing if the run has no rate."""
    if run.rate is None:
        return
    gathered = {name: curve_values(run, column, name) for name in dict.fromkeys(chain(*groups))}
    mute = {name: reason for name, each in gathered.items() if (reason := objection(run, column, *each))}
    for group in groups:
        ranking = _ranking(run, column, [name for name in group if name not in mute], gathered, at)
        why = {name: mute[name] for name in group if name in mute}
        yield replace(ranking, sequence=group[0] if len(group) == 1 else POOLED, uninformative=why)


_Gathered = dict[str, tuple[dict[str, CurveValues], dict[str, str]]]
_Pairs = dict[tuple[int, int], Evidence]
"""By the positions of two curves."""


def _ranking(
    run: RunResult, column: Column, sequences: Sequence[str], gathered: _Gathered, at: float | None
) -> Ranking:
    values = {name: gathered[name][0] for name in sequences}
    curves, left_out = _comparable(run, column, values, {name: gathered[name][1] for name in sequences}, at)
    by_sequence = {name: _evidence_on(curves, of_curves, at) for name, of_curves in values.items()}
    evidence = _over_sequences(by_sequence.values())
    anchors = anchors_of({curve: values[sequences[0]][curve].points for curve in curves}, run.schema.anchors)
    any_curve = [next(iter(found.values())) for found in values.values() if found]
    named = {pair: (curves[pair[0]], curves[pair[1]]) for pair in evidence}
    most_doubt = {pair: max(by_sequence, key=lambda name: by_sequence[name][pair].doubt) for pair in evidence}
    unsettled = [
        pair
        for pair, found in evidence.items()
        if not found.at_least and found.doubt >= 0.5 * abs(abs(found.mean) - SMALLEST)
    ]
    return Ranking(
        column,
        POOLED,
        sum(curve.qualities.shape[1] for curve in any_curve),
        tuple(sorted({curve.of for curve in any_curve})),
        tuple(_placed(curves, values, evidence, anchors, column, at)),
        left_out,
        tuple(sequences),
        tuple(anchors),
        at,
        tuple((*named[pair], found) for pair, found in evidence.items()),
        _rank_correlation(len(curves), by_sequence),
        tuple(name for name, found in by_sequence.items() if _too_few(found.values())) if len(sequences) > 1 else (),
        {named[pair]: _widest_gap(named[pair], values[most_doubt[pair]], at) for pair in unsettled},
        tuple(named[pair] for pair in evidence if _disputed([found[pair] for found in by_sequence.values()])),
    )


def _too_few(evidence: Iterable[Evidence]) -> bool:
    """Whether nothing says how sure any of these are."""
    return all(math.isnan(found.variance) for found in evidence)


def _disputed(evidence: list[Evidence]) -> bool:
    """Whether each of two curves is significantly better on some sequence."""
    level = SIGNIFICANCE / len(evidence)
    return {-1.0, 1.0} <= {math.copysign(1.0, found.mean) for found in evidence if found.p_beyond(SMALLEST) < level}


def _widest_gap(names: tuple[str, str], on: Mapping[str, CurveValues], at: float | None) -> Gap:
    """The gap on a sequence of the curve whose settings leave more doubt."""
    both = [on[name] for name in names]
    low, high = max(curve.means[0] for curve in both), min(curve.means[-1] for curve in both)
    if at is not None:
        low = high = float(np.clip(np.mean([curve.mean_at(at) for curve in both]), low, high))
    qualities = np.linspace(low, high, 33)
    gaps = [np.abs(curve.gaps(qualities)) for curve in both]
    worst = int(np.argmax([each.sum() for each in gaps]))
    means = both[worst].means
    widths = np.diff(means)
    if len(gaps[worst]) == len(widths) - 1 and np.isfinite(gaps[worst]).all():
        beside = np.r_[0.0, gaps[worst], 0.0]
        widths = widths * np.maximum(beside[:-1], beside[1:])
    inside = (means[:-1] < high) & (means[1:] > low)
    place = int(np.argmax(widths * inside if inside.any() else widths))
    return Gap(names[worst], (both[worst].points[place], both[worst].points[place + 1]))


def _rank_correlation(count: int, by_sequence: Mapping[str, _Pairs]) -> dict[str, float]:
    """By sequence, Kendall's tau-b of its order and the others' (Kendall 1945, doi:10.1093/biomet/33.3.239)."""
    if len(by_sequence) < 2:
        return {}
    from scipy.stats import kendalltau  # loads for half a second, and few runs have two sequences

    found = {}
    for name, own in by_sequence.items():
        others = _over_sequences(pairs for other, pairs in by_sequence.items() if other != name)
        (better, scores), (better_there, scores_there) = (_significant(count, pairs) for pairs in (own, others))
        if better.any() and better_there.any():
            found[name] = float(kendalltau(scores, scores_there).statistic)
    return found


def _comparable(
    run: RunResult,
    column: Column,
    values: dict[str, dict[str, CurveValues]],
    reasons: dict[str, dict[str, str]],
    at: float | None,
) -> tuple[list[str], dict[str, str]]:
    """Curves that can be compared with another on every sequence, and why the others cannot."""
    baselines = {point.curve for (codec, _), point in run.curves.items() if codec in run.schema.baselines}
    left_out: dict[str, str] = {}
    for result in run.results:
        curve = run.curves[result.cell.codec.name, result.cell.codec.label].curve
        on = result.cell.sequence.name
        if result.cell.evaluator.title == column.evaluator.title and on in values and curve not in values[on]:
            left_out.setdefault(curve, reasons[on].get(curve) or f"{result.status}: {result.reason}")
    known = dict.fromkeys(curve for found in values.values() for curve in found)
    for curve in known:
        absent = [sequence for sequence, found in values.items() if curve not in found]
        if absent:
            left_out.setdefault(curve, f"not run yet on {', '.join(absent)}")
        elif at is not None and (away := [name for name, found in values.items() if not found[curve].contains(at)]):
            left_out.setdefault(curve, f"its settings do not reach this rate on {', '.join(away)}")
    curves = [curve for curve in known if curve not in left_out and curve not in baselines]
    for curve in list(curves):
        others = [other for other in curves if other != curve]
        if not any(
            all(difference(of_curves[curve], of_curves[other], at) is not None for of_curves in values.values())
            for other in others
        ):
            left_out[curve] = "no other codec was measured at its rates"
    return [curve for curve in curves if curve not in left_out], {
        curve: reason for curve, reason in left_out.items() if curve not in baselines
    }


def _over_sequences(by_sequence: Iterable[_Pairs]) -> _Pairs:
    """Of each pair of curves that can be compared on every sequence: the mean over sequences."""
    every = list(by_sequence)
    shared = [pair for pair in every[0] if all(pair in found for found in every)] if every else []
    return {pair: combined([found[pair] for found in every]) for pair in shared}


def _evidence_on(curves: list[str], values: dict[str, CurveValues], at: float | None) -> _Pairs:
    """Of each pair of curves that can be compared on a sequence."""
    members = [values[curve] for curve in curves]
    pairs = {(i, j): difference(members[i], members[j], at) for i, j in combinations(range(len(curves)), 2)}
    return {pair: known.evidence(members[0].of) for pair, known in pairs.items() if known is not None}


def _significant(count: int, evidence: _Pairs) -> tuple[NDArray[np.bool_], Array]:
    """(N, N), whether the row is significantly better than the column, and (N,) scores, by least squares."""
    better = np.zeros((count, count), dtype=bool)
    if not evidence:
        return better, np.zeros(count)
    certain = holm(np.array([found.p_beyond(SMALLEST) for found in evidence.values()])) < SIGNIFICANCE
    weights = np.array([_OF_A_BOUND if found.at_least else 1.0 for found in evidence.values()])
    design = np.zeros((len(evidence), count))
    for row, ((first, second), found) in enumerate(evidence.items()):
        design[row, first], design[row, second] = weights[row], -weights[row]
        winner, loser = (first, second) if found.mean > 0 else (second, first)
        better[winner, loser] = certain[row]
    means = np.array([found.mean for found in evidence.values()])
    scores: Array = np.linalg.lstsq(design, weights * means, rcond=None)[0]
    return better, scores


def _placed(
    curves: list[str],
    values: dict[str, dict[str, CurveValues]],
    evidence: _Pairs,
    anchors: Sequence[str],
    column: Column,
    rate: float | None,
) -> list[Ranked]:
    better, scores = _significant(len(curves), evidence)
    first, last = 1 + better.sum(axis=0), len(curves) - better.sum(axis=1)
    shown = scores.copy()
    if rate is not None:
        shown = np.array([np.mean([of[curve].mean_at(rate) for of in values.values()]) for curve in curves])
    elif anchors:
        anchor = curves.index(anchors[0])
        shown -= shown[anchor]
        for (one, other), known in evidence.items():
            if anchor in (one, other):
                shown[one + other - anchor] = known.mean if other == anchor else -known.mean
    order = sorted(range(len(curves)), key=lambda at: (-shown[at], -scores[at], curves[at]))
    placed = []
    for at in order:
        of_curve = {on: of[curves[at]] for on, of in values.items()}
        placed.append(
            Ranked(
                curves[at],
                int(first[at]),
                int(last[at]),
                tuple(curves[other] for other in order if better[at, other]),
                sum(each.missing for each in of_curve.values()),
                sum(each.qualities.size for each in of_curve.values()),
                float(scores[at]),
                {on: each.points if rate is None else each.settings_at(rate) for on, each in of_curve.items()},
                None if rate is None else from_quality(float(shown[at]), column),
            )
        )
    return placed


def holm(p_values: Array) -> Array:
    """(P,) p-values adjusted so that all that are below a level are true together with that confidence.

    Holm 1979, Scandinavian Journal of Statistics 6(2), 65-70. A NaN, where nothing was tested, stays one.
    """
    adjusted = np.full(len(p_values), np.nan)
    tested = np.flatnonzero(~np.isnan(p_values))
    order = tested[np.argsort(p_values[tested], kind="stable")]
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p_values[order] * factors))
    return adjusted
