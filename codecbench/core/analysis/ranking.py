"""Ranks codecs by the rate that they need for equal quality, with significance tests of all pairs."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, combinations
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

from codecbench.core.analysis.curve_values import SMALLEST, Array, CurveValues, Of, curve_values, difference, objection
from codecbench.core.analysis.evidence import Evidence, combine
from codecbench.core.analysis.limits import POOLED
from codecbench.core.analysis.run_result import Column, RunResult
from codecbench.core.analysis.verdicts import anchors_of, from_quality

SIGNIFICANCE: Final = 0.01
"""Family-wise error rate: the chance that a ranking of equal codecs puts any of them before another."""

_OF_A_BOUND: Final = 1e-3
"""Weight of a bound in scores: it counts only for codecs that no other pair connects."""
NO_COMMON_RATE: Final = "no common rate"
"""Why two ranked codecs are not compared with each other."""


@dataclass(frozen=True)
class Ranked:
    """A codec's place in a ranking."""

    curve: str
    first: int
    """The best place that it may have, given which codecs are significantly better."""
    last: int
    """The worst place that it may have, given which codecs are significantly worse."""
    ahead_of: tuple[str, ...]
    """The curves that it is significantly better than."""
    missing: int
    """How many of its values are missing."""
    values: int
    """How many values it should have."""
    score: float
    """Log of the rate that it saves against the others on average, by least squares over pairs."""
    settings: Mapping[str, tuple[str, ...]]
    """By sequence, names in order of rate: all, or in a ranking at one rate those at or around it."""
    value: float | None = None
    """The column's mean at that rate, interpolated between settings; None in a ranking over all rates."""


@dataclass(frozen=True)
class Gap:
    """Two neighboring settings of a curve; more settings between them would narrow the interval of a difference."""

    curve: str
    points: tuple[str, str]


@dataclass(frozen=True)
class Ranking:
    """Codecs ranked by a column on a sequence, or over all of them (POOLED)."""

    column: Column
    sequence: str
    units: int
    """Number of frames or repeats."""
    of: tuple[Of, ...]
    """What the units are."""
    ranked: tuple[Ranked, ...]
    """By value at the rate; over all rates by the rate vs. the first anchor, or by score if they share none."""
    left_out: dict[str, str]
    """Curves without a place, and why."""
    sequences: tuple[str, ...]
    """Those on which the column is informative."""
    anchors: tuple[str, ...]
    """The curves that rates are compared with."""
    rate: float | None
    """The rate at which codecs are compared; None for all rates that they share."""
    pairs: tuple[tuple[str, str, Evidence], ...]
    """Pairs of curves that share a rate, with the evidence of the first over the second."""
    rank_correlation: dict[str, float]
    """Leave-one-sequence-out rank agreement: by sequence, Kendall's tau-b of the order there and on all others.

    Without sequences if either order has no significant difference."""
    too_few_on: tuple[str, ...] = ()
    """Sequences with too few frames or repeats for a standard error, so that sequences are the samples."""
    gaps: Mapping[tuple[str, str], Gap] = field(default_factory=dict)
    """The widest gap of pairs whose doubt from gaps between settings is half of their difference or more."""
    disputed: tuple[tuple[str, str], ...] = ()
    """Pairs of which each is significantly better on some sequence."""
    uninformative: Mapping[str, str] = field(default_factory=dict)
    """By sequence, why the column ranks no codec there."""

    @cached_property
    def candidates(self) -> tuple[Ranked, ...]:
        """The codecs that may be the best, by score; if the order is a circle, the one with the highest score.

        The others are ruled out by `ahead_of` or by multiple comparisons with the best (Hsu 1984,
        doi:10.1214/aos/1176346732). These use Bonferroni's level in place of Dunnett's, as pairs depend on each other
        in unknown ways.
        """
        no_better: dict[str, list[float]] = defaultdict(list)  # one-sided p-values of those that seem better
        for first, second, evidence in self.pairs:
            chance = evidence.p_beyond(SMALLEST) / 2.0
            no_better[first].append(chance if evidence.mean < 0.0 else 1.0)
            no_better[second].append(chance if evidence.mean > 0.0 else 1.0)
        order = sorted(self.ranked, key=lambda ranked: -ranked.score)
        return tuple(
            ranked for ranked in order
            if ranked.first == 1 and all(p >= SIGNIFICANCE / len(ps) for ps in [no_better[ranked.curve]] for p in ps)
        ) or tuple(order[:1])  # fmt: skip

    @property
    def recommended(self) -> Ranked:
        """The codec to take: the highest score of those that may be the best.

        Raises ValueError if no codec is ranked, as with an uninformative column.
        """
        return max(self.candidates, key=lambda ranked: ranked.score)

    @property
    def as_good(self) -> tuple[str, ...]:
        """Other curves that may be the best."""
        return tuple(ranked.curve for ranked in self.candidates[1:])

    def evidence(self, first: str, second: str) -> Evidence | None:
        """The log of the second curve's rate over the first's; None if they are not compared."""
        for one, other, evidence in self.pairs:
            if (one, other) == (first, second):
                return evidence
            if (other, one) == (first, second):
                return replace(evidence, mean=-evidence.mean)
        return None

    def without_common_rate(self, curve: str) -> tuple[str, ...]:
        """The ranked curves that share no rate with this one, so that they are not compared."""
        compared = {name for first, second, _ in self.pairs if curve in (first, second) for name in (first, second)}
        others = (ranked.curve for ranked in self.ranked if ranked.curve != curve)
        return tuple(other for other in others if other not in compared)

    @property
    def too_few(self) -> bool:
        """Whether there are too few frames or repeats to compare any two codecs."""
        return _too_few(evidence for _, _, evidence in self.pairs)


def rankings(run: RunResult, *, brief: bool = False, at: float | None = None) -> list[Ranking]:
    """Rank by every headline of role `task`, or else `quality`: over all sequences first, then on each.

    A ranking over all of a single sequence is left out. So are rankings of fewer than two codecs, unless the column is
    uninformative. Empty if the run has no rate. brief: only the first ranking of each column. at: the rate, in its
    metric's unit, at which codecs are compared, interpolated in log rate; without it, all rates that two codecs share.
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
    """Yield the ranking by a column over each group of sequences, of any length; nothing if the run has no rate."""
    if run.rate is None:
        return
    gathered = {name: curve_values(run, column, name) for name in dict.fromkeys(chain(*groups))}
    objections = {name: reason for name, curves in gathered.items() if (reason := objection(run, column, *curves))}
    for group in groups:
        ranking = _ranking(run, column, [name for name in group if name not in objections], gathered, at)
        why = {name: objections[name] for name in group if name in objections}
        yield replace(ranking, sequence=group[0] if len(group) == 1 else POOLED, uninformative=why)


_Gathered = dict[str, tuple[dict[str, CurveValues], dict[str, str]]]
"""By sequence, the curves and why others are left out."""
_Pairs = dict[tuple[int, int], Evidence]
"""Evidence by the positions of two curves."""


def _ranking(
    run: RunResult, column: Column, sequences: Sequence[str], gathered: _Gathered, at: float | None
) -> Ranking:
    values = {name: gathered[name][0] for name in sequences}
    curves, left_out = _comparable_curves(run, column, values, {name: gathered[name][1] for name in sequences}, at)
    by_sequence = {name: _evidence_on(curves, of_curves, at) for name, of_curves in values.items()}
    evidence = _over_sequences(by_sequence.values())
    anchors = anchors_of({curve: values[sequences[0]][curve].points for curve in curves}, run.schema.anchors)
    any_curve = [next(iter(of_curves.values())) for of_curves in values.values() if of_curves]
    names = {pair: (curves[pair[0]], curves[pair[1]]) for pair in evidence}
    most_doubt = {pair: max(by_sequence, key=lambda name: by_sequence[name][pair].doubt) for pair in evidence}
    unsettled = [
        pair
        for pair, known in evidence.items()
        if not known.at_least and known.doubt >= 0.5 * abs(abs(known.mean) - SMALLEST)
    ]
    return Ranking(
        column,
        POOLED,
        sum(curve.qualities.shape[1] for curve in any_curve),
        tuple(sorted({curve.of for curve in any_curve})),
        tuple(_rank(curves, values, evidence, anchors, column, at)),
        left_out,
        tuple(sequences),
        tuple(anchors),
        at,
        tuple((*names[pair], known) for pair, known in evidence.items()),
        _rank_correlation(len(curves), by_sequence),
        tuple(name for name, pairs in by_sequence.items() if _too_few(pairs.values())) if len(sequences) > 1 else (),
        {names[pair]: _widest_gap(names[pair], values[most_doubt[pair]], at) for pair in unsettled},
        tuple(names[pair] for pair in evidence if _is_disputed([pairs[pair] for pairs in by_sequence.values()])),
    )


def _too_few(evidence: Iterable[Evidence]) -> bool:
    """Whether none of these has a variance."""
    return all(math.isnan(known.variance) for known in evidence)


def _is_disputed(evidence: list[Evidence]) -> bool:
    """Whether each of two curves is significantly better on some sequence."""
    level = SIGNIFICANCE / len(evidence)
    return {-1.0, 1.0} <= {math.copysign(1.0, known.mean) for known in evidence if known.p_beyond(SMALLEST) < level}


def _widest_gap(names: tuple[str, str], curves: Mapping[str, CurveValues], at: float | None) -> Gap:
    """The widest gap on a sequence of whichever curve's gaps cause more doubt."""
    both = [curves[name] for name in names]
    low, high = max(curve.means[0] for curve in both), min(curve.means[-1] for curve in both)
    if at is not None:
        low = high = float(np.clip(np.mean([curve.mean_at(at) for curve in both]), low, high))
    qualities = np.linspace(low, high, 33)
    gaps = [np.abs(curve.gaps(qualities)) for curve in both]
    worst = int(np.argmax([errors.sum() for errors in gaps]))
    means = both[worst].means
    widths = np.diff(means)
    if len(gaps[worst]) == len(widths) - 1 and np.isfinite(gaps[worst]).all():
        of_neighbors = np.r_[0.0, gaps[worst], 0.0]
        widths = widths * np.maximum(of_neighbors[:-1], of_neighbors[1:])
    inside = (means[:-1] < high) & (means[1:] > low)
    place = int(np.argmax(widths * inside if inside.any() else widths))
    return Gap(names[worst], (both[worst].points[place], both[worst].points[place + 1]))


def _rank_correlation(count: int, by_sequence: Mapping[str, _Pairs]) -> dict[str, float]:
    """By sequence, Kendall's tau-b of its order and the others' (Kendall 1945, doi:10.1093/biomet/33.3.239)."""
    if len(by_sequence) < 2:
        return {}

    correlations = {}
    for name, pairs_here in by_sequence.items():
        others = _over_sequences(pairs for other, pairs in by_sequence.items() if other != name)
        (better, scores), (better_there, scores_there) = (_significance(count, of) for of in (pairs_here, others))
        if better.any() and better_there.any():
            correlations[name] = float(scipy.stats.kendalltau(scores, scores_there).statistic)
    return correlations


def _comparable_curves(
    run: RunResult,
    column: Column,
    values: dict[str, dict[str, CurveValues]],
    reasons: dict[str, dict[str, str]],
    at: float | None,
) -> tuple[list[str], dict[str, str]]:
    """The curves that can be compared with another on every sequence, and why the others cannot."""
    baselines = {point.curve for (codec, _), point in run.curves.items() if codec in run.schema.baselines}
    left_out: dict[str, str] = {}
    for result in run.results:
        curve = run.curves[result.cell.codec.name, result.cell.codec.label].curve
        on = result.cell.sequence.name
        if result.cell.evaluator.title == column.evaluator.title and on in values and curve not in values[on]:
            left_out.setdefault(curve, reasons[on].get(curve) or f"{result.status}: {result.reason}")
    known = dict.fromkeys(curve for of_curves in values.values() for curve in of_curves)
    for curve in known:
        absent = [sequence for sequence, of_curves in values.items() if curve not in of_curves]
        if absent:
            left_out.setdefault(curve, f"not run yet on {', '.join(absent)}")
        elif at is not None and (away := [name for name, of in values.items() if not of[curve].contains(at)]):
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
    """Average over sequences the evidence of each pair of curves that can be compared on every sequence."""
    sequences = list(by_sequence)
    shared = [pair for pair in sequences[0] if all(pair in pairs for pairs in sequences)] if sequences else []
    return {pair: combine([pairs[pair] for pairs in sequences]) for pair in shared}


def _evidence_on(curves: list[str], values: dict[str, CurveValues], at: float | None) -> _Pairs:
    """The evidence of each pair of curves that can be compared on a sequence."""
    members = [values[curve] for curve in curves]
    pairs = {(i, j): difference(members[i], members[j], at) for i, j in combinations(range(len(curves)), 2)}
    return {pair: known.evidence(members[0].of) for pair, known in pairs.items() if known is not None}


def _significance(count: int, evidence: _Pairs) -> tuple[NDArray[np.bool_], Array]:
    """(N, N) whether the row is significantly better than the column, and (N,) scores, by least squares."""
    better = np.zeros((count, count), dtype=bool)
    if not evidence:
        return better, np.zeros(count)
    certain = holm(np.array([known.p_beyond(SMALLEST) for known in evidence.values()])) < SIGNIFICANCE
    weights = np.array([_OF_A_BOUND if known.at_least else 1.0 for known in evidence.values()])
    design = np.zeros((len(evidence), count))
    for row, ((first, second), known) in enumerate(evidence.items()):
        design[row, first], design[row, second] = weights[row], -weights[row]
        winner, loser = (first, second) if known.mean > 0 else (second, first)
        better[winner, loser] = certain[row]
    means = np.array([known.mean for known in evidence.values()])
    scores: Array = np.linalg.lstsq(design, weights * means, rcond=None)[0]
    return better, scores


def _rank(
    curves: list[str],
    values: dict[str, dict[str, CurveValues]],
    evidence: _Pairs,
    anchors: Sequence[str],
    column: Column,
    rate: float | None,
) -> list[Ranked]:
    better, scores = _significance(len(curves), evidence)
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
    ranked = []
    for at in order:
        of_curve = {on: of[curves[at]] for on, of in values.items()}
        ranked.append(
            Ranked(
                curves[at],
                int(first[at]),
                int(last[at]),
                tuple(curves[other] for other in order if better[at, other]),
                sum(curve.missing for curve in of_curve.values()),
                sum(curve.qualities.size for curve in of_curve.values()),
                float(scores[at]),
                {on: curve.points if rate is None else curve.settings_at(rate) for on, curve in of_curve.items()},
                None if rate is None else from_quality(float(shown[at]), column),
            )
        )
    return ranked


def holm(p_values: Array) -> Array:
    """Adjust (P,) p-values for multiple tests, so that the level bounds the family-wise error rate.

    Holm 1979, Scandinavian Journal of Statistics 6(2), 65-70. A NaN, which means no test, stays one.
    """
    adjusted = np.full(len(p_values), np.nan)
    tested = np.flatnonzero(~np.isnan(p_values))
    order = tested[np.argsort(p_values[tested], kind="stable")]
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p_values[order] * factors))
    return adjusted
