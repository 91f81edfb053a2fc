"""The answer of a run: the setting to take and a sentence for each codec, as far as its runs and frames show."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile
from typing import Final

from codecbench.core.analysis.limits import POOLED, Limit, criteria, limits
from codecbench.core.analysis.passing import Level, Standing, Test, describe, parts
from codecbench.core.analysis.ranking import rankings
from codecbench.core.analysis.run_result import Column, RunResult
from codecbench.core.engine.planning.model import SearchFinding
from codecbench.core.report.choosing import link_verdicts
from codecbench.core.report.costs import coarser_settings, coding_ms, deciding_cost, rate_words, times_decide
from codecbench.core.report.formatting import (
    Verdict,
    limit_sentence,
    ranked_verdict,
    sequence_words,
    setting_name,
    uninformative_notes,
)

_NO_RATE: Final = "No rate was measured, so the cost of codecs is unknown."


@dataclass(frozen=True)
class Answer:
    """A sentence about a curve."""

    curve: str
    sentence: str
    limit: Limit
    """Its settings, from the highest rate to the lowest, with `lowest` the pick."""

    @property
    def passes(self) -> bool | None:
        """True if it passes at some setting, False if the finest setting fails, None if undecided."""
        if self.limit.lowest is not None:
            return True
        return False if self.limit.settings and self.limit.settings[0].verdict == "fails" else None

    @property
    def setting(self) -> Test | None:
        """The pick, or else the setting that is likeliest to be one, or else the finest."""
        return self.limit.lowest or nearest(self.limit) or next(iter(self.limit.settings), None)


@dataclass(frozen=True)
class Answers:
    """The answers of a run by one list of criteria."""

    basis: str
    """The criteria, and how much was measured, in a sentence."""
    answers: tuple[Answer, ...] = ()
    """Best first, without baselines."""
    about: str = ""
    """The criteria in a few words."""
    sentence: str = ""
    """The setting to take, its cost, what it saves and its confidence; and a line a link."""
    on: str = POOLED
    """The sequence, or all of them (POOLED)."""
    over: str = ""
    """The sequence and the numbers of frames and runs, in words."""
    raw: Limit = field(default_factory=Limit)
    """The settings of the baseline."""
    table: Verdict | None = None
    """The ranking, if there are no criteria."""

    @property
    def lines(self) -> tuple[str, ...]:
        """The basis and the sentence of every codec, for a terminal."""
        return (self.basis, *(answer.sentence for answer in self.answers))

    def __str__(self) -> str:
        return self.sentence


def anchor_of(run: RunResult, answer_set: Answers) -> Answer | None:
    """The first anchor that has a pick, with which the cost of others is compared."""
    picked = [answer for answer in answer_set.answers if answer.limit.lowest is not None]
    return next((answer for name in run.schema.anchors for answer in picked if _codec(answer.curve) == name), None)


def answers(run: RunResult) -> Answers:
    """The answers of a run, over all of its sequences together.

    Each codec is judged by how far it may compress until a setting no longer passes the `criteria`.
    """
    return answers_of_settings(run)[0]


def answers_of_settings(run: RunResult) -> list[Answers]:
    """The answers of a run, followed by those by other settings of its evaluators."""
    run = run.as_calibrated
    if run.rate is None:
        return [Answers(_NO_RATE, sentence=f"Nothing can be recommended: {_NO_RATE[0].lower()}{_NO_RATE[1:]}")]
    judged = [answer_set for columns in criteria(run) if (answer_set := _judge(run, columns)) is not None]
    linked = link_verdicts(run)
    if not linked:
        return judged or [_answer_by_ranking(run)]
    first, *others = judged or [Answers("Settings are judged by the frames that arrive over each link.", about="links")]
    lines = [*filter(None, [first.sentence]), *linked[-1].sentences]
    return [replace(first, sentence="\n".join(lines)), *others]


def _answer_by_ranking(run: RunResult) -> Answers:
    """The answer of a run without criteria."""
    on = _answer_sequence(run)
    rankings_there = [ranking for ranking in rankings(run, brief=True) if ranking.sequence == on]
    ranking = next((ranking for ranking in rankings_there if ranking.ranked), None)
    if ranking is None:
        nothing = "Neither a task nor quality was measured for two codecs, so they cannot be compared."
        basis = next((reason for silent in rankings_there for reason in uninformative_notes(silent)), nothing)
        return Answers(basis, sentence=f"Nothing can be recommended: {basis[0].lower()}{basis[1:]}")
    verdict = ranked_verdict(run, ranking)
    brief = replace(verdict, heads=verdict.heads[:-1], rows=tuple(row[:-1] for row in verdict.rows), sentences=())
    judged_by = f"Judged by {ranking.column.label}, {sequence_words(on)}"
    basis = f"{judged_by}; add codec raw, the baseline by which settings pass or fail."
    return Answers(basis, (), ranking.column.label, verdict.sentences[0], on, table=brief)


def _answer_sequence(run: RunResult) -> str:
    """The sequence of the answers: the only one, or all."""
    return run.plan.sequences[0].name if len(run.plan.sequences) == 1 else POOLED


@dataclass(frozen=True)
class _Judged:
    """The limits of the curves of a run on a sequence, or on all (POOLED)."""

    run: RunResult
    on: str
    limits: Mapping[str, Limit]
    """Best first, without baselines."""
    silent: Sequence[str] = ()
    """Of several sequences those on which nothing can be judged."""

    def cost(self, curve: str, test: Test) -> float:
        return deciding_cost(self.run, self.on, curve, test)

    def cost_words(self, curve: str, test: Test, *, brief: bool = False) -> str:
        """The cost of a setting, in words."""
        rate = rate_words(self.run, self.on, curve, test, brief=brief)
        if not times_decide(self.run):
            return rate
        encode_ms, decode_ms = coding_ms(self.run, self.on, curve, test)
        if brief:
            return f"{encode_ms + decode_ms:.3g} ms"
        return f"{encode_ms:.3g} ms to encode and {decode_ms:.3g} ms to decode a frame, {rate}"

    def less(self, curve: str, taken: Test, other: str, than: Test) -> str:
        share = 100.0 * (1.0 - self.cost(curve, taken) / self.cost(other, than))
        return f"{share:.0f} % less{' time' if times_decide(self.run) else ''}"

    @property
    def stopped_searches(self) -> dict[str, SearchFinding]:
        """The searches that were stopped, by codec."""
        return {search.codec: search for search in self.run.plan.searches if search.state == "stopped"}

    @property
    def anchors(self) -> list[str]:
        return [curve for name in self.run.schema.anchors for curve in self.limits if _codec(curve) == name]


def _judge(run: RunResult, columns: list[Column]) -> Answers | None:
    """Judge every curve by some criteria; None if there are no curves."""
    on = _answer_sequence(run)
    by_sequence = limits(run, columns)
    curves = {curve: limit for (sequence, curve), limit in by_sequence.items() if sequence == on}
    if not curves:
        return None
    raw = next((limit for curve, limit in curves.items() if _codec(curve) in run.schema.baselines), Limit())
    others = {curve: limit for curve, limit in curves.items() if _codec(curve) not in run.schema.baselines}
    unsorted = _Judged(run, on, others)
    informative = {sequence for (sequence, _), limit in by_sequence.items() if not limit.reason}
    silent = [entry.name for entry in run.plan.sequences if entry.name not in informative] if on == POOLED else []
    judged = _Judged(run, on, dict(sorted(others.items(), key=lambda item: _place(unsorted, *item))), silent)
    what = " and ".join(column.label for column in columns)
    requirement = _requirement(raw, *curves.values())
    over = _extent(run, curves.values())
    basis = f"A setting passes by “{what}”{requirement and f' ({requirement})'}, {over}"
    if raw.settings:
        basis += f"; raw itself: {describe(raw.settings[0])}"
    answer_set = tuple(
        Answer(curve, limit_sentence(run, on, curve, limit), limit) for curve, limit in judged.limits.items()
    )
    return Answers(f"{basis}.", answer_set, what, _answer_sentence(judged, raw), on, over, raw)


def _codec(curve: str) -> str:
    return curve.split(" ")[0]


def _place(judged: _Judged, curve: str, limit: Limit) -> tuple[int, float]:
    """The sort key: picks by cost, then curves that may pass by rate, and last those that pass nowhere."""
    if limit.lowest is not None:
        cost = judged.cost(curve, limit.lowest)
        return 0, math.inf if math.isnan(cost) else cost
    likely = nearest(limit)
    return (2, 0.0) if likely is None else (1, likely.rate)


def _requirement(*limits_of_curves: Limit) -> str:
    """The criteria in numbers, from the first setting that has them."""
    tests = (setting for limit in limits_of_curves for setting in limit.settings)
    texts = ("; ".join(part.requirement for part in parts(test) if part.requirement) for test in tests)
    return next(filter(None, texts), "")


def _extent(run: RunResult, limits_of_curves: Iterable[Limit] = ()) -> str:
    """`fr3, the first 150 of 798 frames, 4 runs per setting`."""
    tests = [part for limit in limits_of_curves for setting in limit.settings for part in parts(setting)]
    runs = max((test.runs for test in tests if isinstance(test, Standing)), default=0)
    many = f", {runs} {'run' if runs == 1 else 'runs'} per setting" if runs else ""
    sequences = run.plan.sequences
    if len(sequences) > 1:
        return f"{len(sequences)} sequences together{many}"
    used = next((note.removesuffix(" are used") for note in sequences[0].notes if note.endswith("frames are used")), "")
    return f"{sequences[0].name}, {used or f'{sequences[0].frames} frames'}{many}"


def _answer_sentence(judged: _Judged, raw: Limit) -> str:
    """The setting to take, or why nothing is known to pass."""
    passing = [(curve, limit) for curve, limit in judged.limits.items() if limit.lowest is not None]
    return _use_sentence(judged, *passing[0]) if passing else _nothing_sentence(judged, raw)


def _use_sentence(judged: _Judged, curve: str, limit: Limit) -> str:
    """`Use h264 crf=30: 0.59 Mbit/s ..., 79 % less than the smallest jpeg that passes (...); ..., first 150 frames.`"""
    taken = limit.lowest
    assert taken is not None
    endless = limit.next is None and not times_decide(judged.run)
    words = [f"Use {setting_name(curve, taken)}{' or coarser' if endless else ''}: {judged.cost_words(curve, taken)}"]
    saved = _saving(judged, curve, taken)
    sure = "; ".join(_confidence(part) for part in parts(taken))
    words[0] += f", {saved}" if saved else ""
    silent = f" (nothing can be judged on {', '.join(judged.silent)})" if judged.silent else ""
    words += [f"{sure}, {_extent(judged.run)}{silent}"]
    if endless:
        coarser = [name for name in dict.fromkeys([curve, *judged.anchors[:1]]) if judged.limits[name].next is None]
        more = [spelled for name in coarser if (spelled := coarser_settings(judged.run, name))]
        words.append(f"nothing failed, so the limit is lower{': try ' if more else ''}{' and '.join(more)}")
    passing = {_codec(name) for name, other in judged.limits.items() if other.lowest is not None}
    if untried := [codec for codec in judged.stopped_searches if codec not in passing]:
        words.append(f"search unfinished: {', '.join(untried)}")
    return f"{'; '.join(words)}."


def _confidence(test: Standing | Level) -> str:
    """`tracked like raw in 4 of 4 runs (at least 51 % at 95 %)`."""
    if isinstance(test, Standing):
        asked = f": {test.requirement}" if test.requirement else ""
        share = f"{100 * test.interval[0]:.0f} % at 95 %"
        return f"{test.label} in {test.successes} of {test.runs} runs (at least {share}){asked}"
    return f"{test.label}: {test}"


def _saving(judged: _Judged, curve: str, taken: Test) -> str:
    """The saving against the anchor's smallest setting that passes; of the anchor itself, against the next codec."""
    anchors = judged.anchors
    name = next((anchor for anchor in anchors if judged.limits[anchor].lowest is not None), "")
    if curve in anchors:
        others = [(other, limit.lowest) for other, limit in judged.limits.items() if other != curve]
        following = [(other, lowest) for other, lowest in others if lowest is not None]
        if not following:
            return "the only codec known to pass" if others else ""
        other, least = following[0]
        return (
            f"{judged.less(curve, taken, other, least)} than the next codec that passes ({setting_name(other, least)})"
        )
    if not name:
        return f"while no {_codec(anchors[0])} setting tried passes" if anchors else ""
    lowest = judged.limits[name].lowest
    assert lowest is not None
    which = "coarsest" if judged.limits[name].next is None else "smallest"
    tried = f"{which} {name} {'tried' if which == 'coarsest' else 'that passes'}"
    cost = judged.cost_words(name, lowest, brief=True)
    return f"{judged.less(curve, taken, name, lowest)} than the {tried} ({lowest.point}, {cost})"


def _nothing_sentence(judged: _Judged, raw: Limit) -> str:
    """Why nothing is known to pass: the nearest setting or the failing ones."""
    if not judged.limits:
        return "Nothing can be recommended: only the baseline was measured."
    if reason := next((limit.reason for limit in judged.limits.values() if limit.reason), ""):
        return f"Nothing can be recommended here: {reason}."
    likely = [(curve, near) for curve, limit in judged.limits.items() if (near := nearest(limit)) is not None]
    if likely:
        curve, near = min(likely, key=lambda item: item[1].rate)
        return f"Nothing is known to pass here: the nearest is {setting_name(curve, near)} ({describe(near)})."
    if stopped := next(iter(judged.stopped_searches.values()), None):
        return f"Nothing is known to pass here, because a search is unfinished: {stopped.codec}: {stopped.words}."
    finest = [(curve, limit.settings[0]) for curve, limit in judged.limits.items() if limit.settings]
    failing = "; ".join(f"{setting_name(curve, test)} ({describe(test)})" for curve, test in finest[:2])
    beside = f"; raw itself: {describe(raw.settings[0])}" if raw.settings and raw.lowest is None else ""
    return f"Nothing passes here, because the finest settings tried fail: {failing}{beside}."


def nearest(limit: Limit) -> Test | None:
    """The setting of lowest rate that, with all above it, would pass if more runs or frames went on like these."""
    likely = list(takewhile(_is_likely, limit.settings))
    return likely[-1] if likely else None


def _is_likely(test: Test) -> bool:
    return all(
        part.successes == part.runs if isinstance(part, Standing) else part.margin.mean > 0.0 for part in parts(test)
    )
