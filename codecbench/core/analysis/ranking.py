"""Codecs in order of the rate at which they serve a task equally well, as far as a run can tell them apart."""

from __future__ import annotations

import math
import string
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.analysis.bjontegaard import BdRate
from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.curve_values import SMALLEST, Array, CurveValues, Of, curve_values, difference, objection
from codecbench.core.analysis.evidence import Evidence, combined
from codecbench.core.analysis.limits import POOLED
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.verdicts import SequenceCurve, anchors_of, bd_rates_by_anchor, from_quality

SIGNIFICANCE: Final = 0.01
"""Chance that a ranking of codecs that are all alike puts any of them before another."""

NO_COMMON_RATE: Final = "no common rate to compare at"
"""Why two codecs that both have a place are not compared with each other."""


@dataclass(frozen=True)
class Ranked:
    """A codec's place. first, last: the places that it may have, from those that are told apart from it.

    ahead_of: the curves that it is better than. group: letters; who shares one cannot be told apart. bd_rates: by
    anchor, without an interval, for what may be claimed is in the other fields; none against itself. missing, values:
    how many of its values are missing, of how many. score: how much better it is than the others on average, by least
    squares over pairs; known less surely than places are. In a ranking at one rate, value is the column's mean there,
    between settings, and settings, by sequence, the one that has this rate or the two around it.
    """

    curve: str
    first: int
    last: int
    ahead_of: tuple[str, ...]
    group: str
    bd_rates: dict[str, BdRate]
    missing: int
    values: int
    score: float
    value: float | None = None
    settings: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Ranking:
    """Codecs by a column on a sequence, or over all of them (POOLED), compared over so many frames or repeats.

    ranked: by place, first and last, then by score. left_out: curves without a place, and why. anchors: whom BD-rates
    are against. rate: at which codecs are compared; None for all rates that they share. pairs: what is known of two
    curves that share a rate, of the first over the second. rank_correlation: by sequence, Kendall's tau-b of the order
    there and that of all other sequences together; empty for a single sequence. too_few_on: of several sequences those
    that have too few frames or repeats to say how sure they are, so that sequences are the samples.
    """

    column: Column
    sequence: str
    units: int
    of: tuple[Of, ...]
    ranked: tuple[Ranked, ...]
    left_out: dict[str, str]
    anchors: tuple[str, ...]
    rate: float | None
    pairs: tuple[tuple[str, str, Evidence], ...]
    rank_correlation: dict[str, float]
    too_few_on: tuple[str, ...] = ()
    uninformative: Mapping[str, str] = field(default_factory=dict)

    @property
    def recommended(self) -> Ranked:
        """The codec to take: of those than which none is told to be better (in a circle: of all) the highest score.

        Raises ValueError where nobody is ranked, as the column is uninformative.
        """
        unbeaten = [ranked for ranked in self.ranked if ranked.first == 1]
        return max(unbeaten or self.ranked, key=lambda ranked: ranked.score)

    @property
    def as_good(self) -> tuple[str, ...]:
        """Other curves than which none is told to be better."""
        return tuple(each.curve for each in self.ranked if each.first == 1 and each is not self.recommended)

    def evidence(self, first: str, second: str) -> Evidence | None:
        """What is known of two curves: the log of how many times the first one's rate the second takes."""
        for one, other, found in self.pairs:
            if (one, other) == (first, second):
                return found
            if (other, one) == (first, second):
                return replace(found, mean=-found.mean)
        return None

    @property
    def equal(self) -> tuple[tuple[str, str], ...]:
        """Pairs of curves that take the same rate within the smallest difference worth knowing."""
        confidence = 1.0 - SIGNIFICANCE / max(1, len(self.pairs))
        return tuple(
            (first, second) for first, second, found in self.pairs
            if abs(found.mean) + found.reach(confidence) < SMALLEST
        )  # fmt: skip

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

    A ranking over all of a single sequence is left out, as are those that would have less than two codecs; not so where
    the column is uninformative, which they say instead. Nothing where the run has no rate. brief: only the first of
    each column. at: the rate, in its metric's unit, at which codecs are compared, linearly between the logarithms of
    their settings' rates; all rates that two codecs share, without it.
    """
    columns = [c for c in run.headlines("task") or run.headlines("quality")[:1] if c.metric.better != "neither"]
    if run.rate is None:
        return []
    found = []
    for column in columns:
        sequences = [entry.name for entry in run.plan.sequences]
        rates = bd_rates_by_anchor(run, column, resamples=0)
        gathered = {name: curve_values(run, column, name) for name in sequences}
        mute = {name: reason for name, each in gathered.items() if (reason := objection(run, column, *each))}
        groups = [sequences] if len(sequences) > 1 else []
        groups += [] if groups and brief else [[name] for name in sequences]
        for group in groups:
            told = [name for name in group if name not in mute]
            ranking = _ranking(run, column, told, gathered, rates, at)
            if len(ranking.ranked) > 1 or not told:
                why = {name: mute[name] for name in group if name in mute}
                sequence = group[0] if len(group) == 1 else POOLED
                found.append(replace(ranking, sequence=sequence, uninformative=why))
    return found


_Rates = dict[str, dict[SequenceCurve, BdRate]]
"""BD-rates by anchor."""
_Gathered = dict[str, tuple[dict[str, CurveValues], dict[str, str]]]


def _ranking(
    run: RunResult,
    column: Column,
    sequences: Sequence[str],
    gathered: _Gathered,
    rates: _Rates,
    at: float | None,
) -> Ranking:
    values = {name: gathered[name][0] for name in sequences}
    curves, left_out = _comparable(run, column, values, {name: gathered[name][1] for name in sequences}, at)
    evidence = _evidence(curves, values, at)
    matrices = _told_apart(len(curves), evidence)
    placed = {curve: values[sequences[0]][curve].log_rates.tolist() for curve in curves}
    anchors = anchors_of(placed, run.schema.anchors)
    if "" in rates:  # each sequence has its own
        rates = dict.fromkeys(anchors[:1], rates[""])
    any_curve = [next(iter(found.values())) for found in values.values() if found]
    return Ranking(
        column,
        POOLED,
        sum(curve.qualities.shape[1] for curve in any_curve),
        tuple(sorted({curve.of for curve in any_curve})),
        tuple(_placed(curves, values, matrices, rates, column, at)),
        left_out,
        tuple(rates),
        at,
        tuple((curves[first], curves[second], found) for (first, second), found in evidence.items()),
        _rank_correlation(curves, values, at),
        tuple(name for name in sequences if _too_few(_evidence(curves, {name: values[name]}, at).values()))
        if len(sequences) > 1
        else (),
    )


def _too_few(evidence: Iterable[Evidence]) -> bool:
    """Whether nothing says how sure any of these are."""
    return all(math.isnan(found.variance) for found in evidence)


def _rank_correlation(
    curves: list[str], values: dict[str, dict[str, CurveValues]], at: float | None
) -> dict[str, float]:
    """By sequence, Kendall's tau-b of its order and the others' (Kendall 1945, doi:10.1093/biomet/33.3.239)."""

    def scores(names: list[str]) -> Array:
        evidence = _evidence(curves, {name: values[name] for name in names}, at)
        return _told_apart(len(curves), evidence).scores

    if len(values) < 2 or len(curves) < 2:
        return {}
    from scipy.stats import kendalltau  # loads for half a second, and few runs have two sequences

    return {
        name: float(kendalltau(scores([name]), scores([other for other in values if other != name])).statistic)
        for name in values
    }


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


def _evidence(
    curves: list[str], values: dict[str, dict[str, CurveValues]], at: float | None
) -> dict[tuple[int, int], Evidence]:
    """Of each pair of curves that can be compared on every sequence, by position: the mean over sequences."""
    by_sequence = [_evidence_on(curves, of_curves, at) for of_curves in values.values()]
    return {
        pair: combined([found[pair] for found in by_sequence])
        for pair in combinations(range(len(curves)), 2)
        if all(pair in found for found in by_sequence)
    }


def _evidence_on(
    curves: list[str], values: dict[str, CurveValues], at: float | None
) -> dict[tuple[int, int], Evidence]:
    """Of each pair of curves that can be compared on a sequence."""
    pairs = {
        (i, j): difference(values[curves[i]], values[curves[j]], at) for i, j in combinations(range(len(curves)), 2)
    }
    return {pair: known.evidence(values[curves[pair[0]]].of) for pair, known in pairs.items() if known is not None}


@dataclass(frozen=True)
class _Matrices:
    """better: (N, N), whether the row is told to be better than the column. scores: (N,), least squares over pairs."""

    better: NDArray[np.bool_]
    scores: Array


def _told_apart(count: int, evidence: dict[tuple[int, int], Evidence]) -> _Matrices:
    better = np.zeros((count, count), dtype=bool)
    if not evidence:
        return _Matrices(better, np.zeros(count))
    certain = holm(np.array([found.p_beyond(SMALLEST) for found in evidence.values()])) < SIGNIFICANCE
    design = np.zeros((len(evidence), count))
    for row, ((first, second), found) in enumerate(evidence.items()):
        design[row, first], design[row, second] = 1.0, -1.0
        winner, loser = (first, second) if found.mean > 0 else (second, first)
        better[winner, loser] = certain[row]
    scores: Array = np.linalg.lstsq(design, np.array([found.mean for found in evidence.values()]), rcond=None)[0]
    return _Matrices(better, scores)


def _placed(
    curves: list[str],
    values: dict[str, dict[str, CurveValues]],
    matrices: _Matrices,
    rates: _Rates,
    column: Column,
    rate: float | None,
) -> list[Ranked]:
    better = matrices.better
    first, last = 1 + better.sum(axis=0), len(curves) - better.sum(axis=1)
    order = sorted(range(len(curves)), key=lambda at: (first[at], last[at], -matrices.scores[at], curves[at]))
    apart = (better | better.T)[np.ix_(order, order)]
    groups = joined_groups(apart)
    placed = []
    for place, at in enumerate(order):
        curve = curves[at]
        of_curve = [found[curve] for found in values.values()]
        placed.append(
            Ranked(
                curve,
                int(first[at]),
                int(last[at]),
                tuple(curves[other] for other in order if better[at, other]),
                "".join(_letter(number) for number, group in enumerate(groups) if place in group),
                _beside(curve, list(values), rates),
                sum(found.missing for found in of_curve),
                sum(found.qualities.size for found in of_curve),
                float(matrices.scores[at]),
                None if rate is None else from_quality(_mean_at(of_curve, rate), column),
                {} if rate is None else {on: found[curve].settings_at(rate) for on, found in values.items()},
            )
        )
    return placed


def _beside(curve: str, sequences: list[str], rates: _Rates) -> dict[str, BdRate]:
    """The BD-rates of a curve over sequences, by anchor."""
    found = {
        anchor: _over_sequences([of_curves.get((name, curve)) for name in sequences])
        for anchor, of_curves in rates.items()
        if anchor != curve
    }
    return {anchor: rate for anchor, rate in found.items() if rate is not None}


def _mean_at(of_curve: list[CurveValues], rate: float) -> float:
    """The mean over sequences of the mean quality at a rate."""
    return float(np.mean([found.mean_at(rate) for found in of_curve]))


def _letter(number: int) -> str:
    return string.ascii_lowercase[number] if number < 26 else f"({number + 1})"


def _over_sequences(found: list[BdRate | None]) -> BdRate | None:
    """The geometric mean of the factors in rate, with a reason where a sequence has none."""
    present = [rate for rate in found if rate is not None]
    if len(found) == 1 or not present:
        return present[0] if present else None
    numbers = [rate.percent for rate in present if not rate.reason]
    if len(numbers) < len(found):
        return replace(present[0], percent=float("nan"), interval=None,
                       reason=f"only {len(numbers)} of {len(found)} sequences have one")  # fmt: skip
    mean = 100.0 * (float(np.exp(np.mean(np.log1p(np.array(numbers) / 100.0)))) - 1.0)
    return replace(present[0], percent=mean, interval=None)


_MOST_STEPS: Final = 10_000
"""Of the search for groups."""


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


def joined_groups(apart: NDArray[np.bool_]) -> list[tuple[int, ...]]:
    """The largest groups of which no two members are told apart, in order; everybody is in one or more.

    apart: (N, N), symmetric, in order of place. Maximal cliques of the complement, by Bron and Kerbosch 1973,
    doi:10.1145/362342.362367, with a pivot. There can be more of them than anybody could list: then the longest runs of
    neighbours in order, which are at most N.
    """
    near = [set(np.flatnonzero(~row).tolist()) - {place} for place, row in enumerate(apart)]
    found: list[tuple[int, ...]] = []
    waiting: list[tuple[tuple[int, ...], set[int], set[int]]] = [((), set(range(len(near))), set())]
    for _ in range(_MOST_STEPS):
        if not waiting:
            return sorted(found)
        members, candidates, done = waiting.pop()
        if not candidates and not done and members:
            found.append(tuple(sorted(members)))
        if not candidates:
            continue
        pivot = max(sorted(candidates | done), key=lambda place: len(near[place]))
        for place in sorted(candidates - near[pivot]):
            waiting.append(((*members, place), candidates & near[place], done & near[place]))
            candidates.remove(place)
            done.add(place)
    return longest_runs(apart)


def longest_runs(apart: NDArray[np.bool_]) -> list[tuple[int, ...]]:
    """The longest runs of neighbours in order of which no two are told apart."""
    found: list[tuple[int, ...]] = []
    start = 0
    for end in range(len(apart)):
        first = start
        while apart[first : end + 1, end].any():
            first += 1
        if first > start:
            found.append(tuple(range(start, end)))
            start = first
    return [*found, tuple(range(start, len(apart)))]
