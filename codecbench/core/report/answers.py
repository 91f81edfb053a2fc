"""What a run answers: the setting to take and a sentence for each codec, as far as its runs and frames show."""

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
from codecbench.core.report.choosing import over_links
from codecbench.core.report.costs import coarser_settings, coding_ms, deciding_cost, rate_words, times_decide
from codecbench.core.report.formatting import (
    Verdict,
    limit_sentence,
    ranked_verdict,
    sequence_words,
    setting_name,
    uninformative_notes,
)

_NO_RATE: Final = "No rate was measured, so that nothing can be said of what codecs spend."


@dataclass(frozen=True)
class Answer:
    """A sentence about a curve. limit: its settings, from the most rate to the least, with `lowest` the pick."""

    curve: str
    sentence: str
    limit: Limit

    @property
    def passes(self) -> bool | None:
        """Whether it is known to pass at some setting, or to fail from the finest on, or neither."""
        if self.limit.lowest is not None:
            return True
        return False if self.limit.settings and self.limit.settings[0].verdict == "fails" else None

    @property
    def shown(self) -> Test | None:
        """The pick; if there is none, the setting that is likeliest to be one, or else the finest."""
        return self.limit.lowest or nearest(self.limit) or next(iter(self.limit.settings), None)


@dataclass(frozen=True)
class Answers:
    """basis: by what codecs are judged, over how much, in a sentence. answers: best first, baselines left out. about:
    by what, in a few words. sentence: what to take, its cost, what it saves and how sure that is; and a line a link.
    on: the sequence that is spoken of, or all of them (POOLED). over: that in words. raw: the settings of the baseline,
    as of a codec. table: of what is known instead, if nothing says what passes."""

    basis: str
    answers: tuple[Answer, ...] = ()
    about: str = ""
    sentence: str = ""
    on: str = POOLED
    over: str = ""
    raw: Limit = field(default_factory=Limit)
    table: Verdict | None = None

    @property
    def lines(self) -> tuple[str, ...]:
        """The basis and the sentence of every codec, for a terminal."""
        return (self.basis, *(answer.sentence for answer in self.answers))

    def __str__(self) -> str:
        return self.sentence


def anchor_of(run: RunResult, found: Answers) -> Answer | None:
    """The first anchor that has a pick: what others spend stands beside that."""
    picked = [each for each in found.answers if each.limit.lowest is not None]
    return next((each for name in run.schema.anchors for each in picked if each.curve.split(" ")[0] == name), None)


def answers(run: RunResult) -> Answers:
    """The answers of a run, over all of its sequences together.

    Each codec is judged by how far it may compress until a setting no longer passes what is asked: see `criteria`.
    """
    return answers_of_settings(run)[0]


def answers_of_settings(run: RunResult) -> list[Answers]:
    """The answers of a run, and after them those of the same by every other setting of its evaluators."""
    run = run.as_calibrated
    if run.rate is None:
        return [Answers(_NO_RATE, sentence=f"Nothing can be named: {_NO_RATE[0].lower()}{_NO_RATE[1:]}")]
    judged = [found for columns in criteria(run) if (found := _judged(run, columns)) is not None]
    linked = over_links(run)
    if not linked:
        return judged or [_ranked(run)]
    first, *others = judged or [Answers("Settings are judged by what comes over each link.", about="links")]
    lines = [*filter(None, [first.sentence]), *linked[-1].sentences]
    return [replace(first, sentence="\n".join(lines)), *others]


def _ranked(run: RunResult) -> Answers:
    """The answer of a run in which nothing says how good is good enough."""
    on = _on(run)
    every = [each for each in rankings(run, brief=True) if each.sequence == on]
    ranking = next((each for each in every if each.ranked), None)
    if ranking is None:
        nothing = "Neither a task nor quality was measured of two codecs, so that they cannot be judged."
        basis = next((reason for each in every for reason in uninformative_notes(each)), nothing)
        return Answers(basis, sentence=f"Nothing can be named: {basis[0].lower()}{basis[1:]}")
    found = ranked_verdict(run, ranking)
    brief = replace(found, heads=found.heads[:-1], rows=tuple(row[:-1] for row in found.rows), sentences=())
    judged_by = f"Judged by {ranking.column.label}, {sequence_words(on)}"
    basis = f"{judged_by}; add codec raw, beside which a setting passes or fails."
    return Answers(basis, (), ranking.column.label, found.sentences[0], on, table=brief)


def _on(run: RunResult) -> str:
    """The sequence that is spoken of: the only one, or all."""
    return run.plan.sequences[0].name if len(run.plan.sequences) == 1 else POOLED


@dataclass(frozen=True)
class _Judged:
    """What is known of the curves of a run on a sequence. limits: best first, baselines left out. silent: of several
    sequences those on which nothing can be judged.
    """

    run: RunResult
    on: str
    limits: Mapping[str, Limit]
    silent: Sequence[str] = ()

    def spent(self, curve: str, test: Test) -> float:
        return deciding_cost(self.run, self.on, curve, test)

    def cost(self, curve: str, test: Test, *, brief: bool = False) -> str:
        """What a setting spends, in words."""
        rate = rate_words(self.run, self.on, curve, test, brief=brief)
        if not times_decide(self.run):
            return rate
        encode_ms, decode_ms = coding_ms(self.run, self.on, curve, test)
        if brief:
            return f"{encode_ms + decode_ms:.3g} ms"
        return f"{encode_ms:.3g} ms to encode and {decode_ms:.3g} ms to decode a frame, {rate}"

    def less(self, curve: str, taken: Test, other: str, than: Test) -> str:
        share = 100.0 * (1.0 - self.spent(curve, taken) / self.spent(other, than))
        return f"{share:.0f} % less{' time' if times_decide(self.run) else ''}"

    @property
    def stopped(self) -> dict[str, SearchFinding]:
        """Of the codecs whose searches were stopped, by name."""
        return {each.codec: each for each in self.run.plan.searches if each.state == "stopped"}

    @property
    def anchors(self) -> list[str]:
        return [curve for name in self.run.schema.anchors for curve in self.limits if _codec(curve) == name]


def _judged(run: RunResult, columns: list[Column]) -> Answers | None:
    on = _on(run)
    every = limits(run, columns)
    own = {curve: limit for (sequence, curve), limit in every.items() if sequence == on}
    if not own:
        return None
    raw = next((limit for curve, limit in own.items() if _codec(curve) in run.schema.baselines), Limit())
    others = {curve: limit for curve, limit in own.items() if _codec(curve) not in run.schema.baselines}
    unsorted = _Judged(run, on, others)
    judged = {sequence for (sequence, _), limit in every.items() if not limit.reason}
    silent = [each.name for each in run.plan.sequences if each.name not in judged] if on == POOLED else []
    found = _Judged(run, on, dict(sorted(others.items(), key=lambda item: _place(unsorted, *item))), silent)
    what = " and ".join(column.label for column in columns)
    asked = _asked(raw, *own.values())
    over = _over(run, own.values())
    basis = f"A setting passes by “{what}”{asked and f' ({asked})'}, {over}"
    if raw.settings:
        basis += f"; raw itself: {describe(raw.settings[0])}"
    told = tuple(Answer(curve, limit_sentence(run, on, curve, limit), limit) for curve, limit in found.limits.items())
    return Answers(f"{basis}.", told, what, _sentence(found, raw), on, over, raw)


def _codec(curve: str) -> str:
    return curve.split(" ")[0]


def _place(found: _Judged, curve: str, limit: Limit) -> tuple[int, float]:
    """The pick that spends least comes first, then what may pass by its rate, and last a curve that passes nowhere."""
    if limit.lowest is not None:
        deciding_cost = found.spent(curve, limit.lowest)
        return 0, math.inf if math.isnan(deciding_cost) else deciding_cost
    likely = nearest(limit)
    return (2, 0.0) if likely is None else (1, likely.rate)


def _asked(*found: Limit) -> str:
    """What is asked in numbers, by the first setting of which that is known."""
    tests = (setting for limit in found for setting in limit.settings)
    return next((asked for test in tests if (asked := "; ".join(part.asked for part in parts(test) if part.asked))), "")


def _over(run: RunResult, found: Iterable[Limit] = ()) -> str:
    """`fr3, the first 150 of 798 frames, 4 runs a setting`."""
    tests = [part for limit in found for setting in limit.settings for part in parts(setting)]
    runs = max((test.runs for test in tests if isinstance(test, Standing)), default=0)
    many = f", {runs} {'run' if runs == 1 else 'runs'} a setting" if runs else ""
    sequences = run.plan.sequences
    if len(sequences) > 1:
        return f"{len(sequences)} sequences together{many}"
    used = next((note.removesuffix(" are used") for note in sequences[0].notes if note.endswith("frames are used")), "")
    return f"{sequences[0].name}, {used or f'{sequences[0].frames} frames'}{many}"


def _sentence(found: _Judged, raw: Limit) -> str:
    """What to take, or why nothing is known to pass."""
    passing = [(curve, limit) for curve, limit in found.limits.items() if limit.lowest is not None]
    return _use(found, *passing[0]) if passing else _nothing(found, raw)


def _use(found: _Judged, curve: str, limit: Limit) -> str:
    """`Use h264 crf=30: 0.59 Mbit/s ..., 79 % less than the smallest jpeg that passes (...); ..., first 150 frames.`"""
    taken = limit.lowest
    assert taken is not None
    endless = limit.next is None and not times_decide(found.run)
    words = [f"Use {setting_name(curve, taken)}{' or coarser' if endless else ''}: {found.cost(curve, taken)}"]
    saved = _saved(found, curve, taken)
    sure = "; ".join(_sure(part) for part in parts(taken))
    words[0] += f", {saved}" if saved else ""
    silent = f" (nothing can be judged on {', '.join(found.silent)})" if found.silent else ""
    words += [f"{sure}, {_over(found.run)}{silent}"]
    if endless:
        coarser = [name for name in dict.fromkeys([curve, *found.anchors[:1]]) if found.limits[name].next is None]
        more = [spelled for name in coarser if (spelled := coarser_settings(found.run, name))]
        words.append(f"nothing failed, so the limit is lower{': try ' if more else ''}{' and '.join(more)}")
    passing = {_codec(name) for name, each in found.limits.items() if each.lowest is not None}
    if untried := [codec for codec in found.stopped if codec not in passing]:
        words.append(f"not tried to the end: {', '.join(untried)}")
    return f"{'; '.join(words)}."


def _sure(test: Standing | Level) -> str:
    """`tracked like raw in 4 of 4 runs (at least 51 % at 95 %)`."""
    if isinstance(test, Standing):
        asked = f": {test.asked}" if test.asked else ""
        share = f"{100 * test.interval[0]:.0f} % at 95 %"
        return f"{test.label} in {test.successes} of {test.runs} runs (at least {share}){asked}"
    return f"{test.label}: {test}"


def _saved(found: _Judged, curve: str, taken: Test) -> str:
    """What is saved beside the smallest setting of the anchor that passes; of the anchor itself, beside the next."""
    anchors = found.anchors
    name = next((each for each in anchors if found.limits[each].lowest is not None), "")
    if curve in anchors:
        others = [(other, limit.lowest) for other, limit in found.limits.items() if other != curve]
        following = [(other, lowest) for other, lowest in others if lowest is not None]
        if not following:
            return "the only codec known to pass" if others else ""
        other, least = following[0]
        return (
            f"{found.less(curve, taken, other, least)} than the next codec that passes ({setting_name(other, least)})"
        )
    if not name:
        return f"where no {_codec(anchors[0])} setting tried passes" if anchors else ""
    lowest = found.limits[name].lowest
    assert lowest is not None
    which = "coarsest" if found.limits[name].next is None else "smallest"
    tried = f"{which} {name} {'tried' if which == 'coarsest' else 'that passes'}"
    deciding_cost = found.cost(name, lowest, brief=True)
    return f"{found.less(curve, taken, name, lowest)} than the {tried} ({lowest.point}, {deciding_cost})"


def _nothing(found: _Judged, raw: Limit) -> str:
    """Why nothing is known to pass: what came nearest, and what would tell."""
    if not found.limits:
        return "Nothing can be named: no codec was measured beside the baseline."
    if reason := next((limit.reason for limit in found.limits.values() if limit.reason), ""):
        return f"Nothing can be named here: {reason}."
    likely = [(curve, near) for curve, limit in found.limits.items() if (near := nearest(limit)) is not None]
    if likely:
        curve, near = min(likely, key=lambda item: item[1].rate)
        return f"Nothing is known to pass here: nearest is {setting_name(curve, near)} ({describe(near)})."
    if stopped := next(iter(found.stopped.values()), None):
        return f"Nothing is known to pass here, as not all was tried: {stopped.codec}: {stopped.words}."
    finest = [(curve, limit.settings[0]) for curve, limit in found.limits.items() if limit.settings]
    failing = "; ".join(f"{setting_name(curve, test)} ({describe(test)})" for curve, test in finest[:2])
    beside = f"; raw itself: {describe(raw.settings[0])}" if raw.settings and raw.lowest is None else ""
    return f"Nothing passes here, because the finest settings tried do not: {failing}{beside}."


def nearest(limit: Limit) -> Test | None:
    """The setting of least rate that, as all above it, would pass if more runs or frames went on like these."""
    likely = list(takewhile(_is_likely, limit.settings))
    return likely[-1] if likely else None


def _is_likely(test: Test) -> bool:
    return all(
        part.successes == part.runs if isinstance(part, Standing) else part.margin.mean > 0.0 for part in parts(test)
    )
