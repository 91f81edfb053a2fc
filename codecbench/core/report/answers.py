"""What a run answers, in one sentence a codec: as much as its runs and frames show, and no more."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import takewhile
from typing import Final

import numpy as np
import pandas as pd

from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.limits import POOLED, Limit, limits
from codecbench.core.analysis.ranking import NO_COMMON_RATE, Ranked, Ranking, rankings
from codecbench.core.analysis.run_result import RunResult, judged_column, successes
from codecbench.core.report.formatting import (
    SURE,
    baseline_rate,
    less_rate,
    sequences_are_samples,
    share_of_rate,
    uninformative,
    where,
)

_NO_RATE: Final = "No rate was measured, so that nothing can be said of what codecs spend."


@dataclass(frozen=True)
class Answer:
    """A sentence about a curve. holds: whether its task is known to hold at some setting, or to fail, or neither."""

    curve: str
    sentence: str
    holds: bool | None = None


@dataclass(frozen=True)
class Answers:
    """basis: by what codecs are judged, over how much, in a sentence. answers: best first, baselines left out. about:
    by what, in a few words."""

    basis: str
    answers: tuple[Answer, ...] = ()
    about: str = ""

    @property
    def lines(self) -> tuple[str, ...]:
        """The basis and every sentence, for a terminal."""
        return (self.basis, *(answer.sentence for answer in self.answers))


def answers(run: RunResult) -> Answers:
    """The answers of a run, over all of its sequences together.

    Where the run has headlines of role `success` each codec is judged by how far it may compress until they fail, else
    by its place in the first ranking, of a task or, without one, of quality. A run without a rate answers nothing.
    """
    return answers_of_settings(run)[0]


def answers_of_settings(run: RunResult) -> list[Answers]:
    """The answers of a run, and after them those of the same by every other setting of its evaluators."""
    if run.rate is None:
        return [Answers(_NO_RATE)]
    if judged := successes(run):
        return [_held(run, columns) for columns in judged]
    column = judged_column(run)
    if column is None:
        return [Answers("Neither a task nor quality was measured, so that codecs cannot be judged.")]
    same = [other for other in run.headlines(column.metric.role) if other != column
            and (other.evaluator.name, other.measure) == (column.evaluator.name, column.measure)]  # fmt: skip
    found: dict[Column, list[Ranking]] = defaultdict(list)
    for ranking in rankings(run):
        found[ranking.column].append(ranking)
    return [_ranked(run, each, found[each]) for each in (column, *same)]


def _curves(run: RunResult) -> list[str]:
    """All but the baselines'."""
    named = ((codec, point.curve) for (codec, _), point in run.curves.items())
    return list(dict.fromkeys(curve for codec, curve in named if codec not in run.schema.baselines))


def _on(run: RunResult) -> str:
    """The sequence that is spoken of: the only one, or all."""
    return run.plan.sequences[0].name if len(run.plan.sequences) == 1 else POOLED


def _held(run: RunResult, columns: list[Column]) -> Answers:
    on, found = _on(run), limits(run, columns)
    own = {curve: limit for (sequence, curve), limit in found.items() if sequence == on}
    curves = sorted((curve for curve in _curves(run) if curve in own), key=lambda curve: own[curve].rate)
    baseline = next((own[curve] for curve in own if curve.split(" ")[0] in run.schema.baselines), Limit())
    raw = baseline_rate(run, on)
    like = f" like {raw[0]}" if raw is not None and baseline.lowest is not None else ""
    most = max((setting.runs for limit in own.values() for setting in limit.settings), default=0)
    what = " and ".join(column.label for column in columns)
    basis = f"Judged by “{what}”, {where(on)}, {_counted(most, 'run')} a setting"
    if raw is not None and baseline.settings:
        basis += f"; {raw[0]} itself: {baseline.settings[0]}"
    return Answers(f"{basis}.", tuple(_limited(run, on, curve, own[curve], like) for curve in curves), what)


def _limited(run: RunResult, on: str, curve: str, limit: Limit, like: str) -> Answer:
    """How far a curve holds, with the settings on both sides of the limit."""
    if limit.reason or not limit.settings:
        return Answer(curve, f"{curve}: {limit.reason or 'no run'}.")
    if limit.lowest is not None:
        named, share = f"{curve} {limit.lowest.point}".strip(), share_of_rate(run, on, limit.lowest.rate)
        return Answer(curve, f"{named} holds{like} at {share} ({limit.lowest}); {limit.after_words()}.", True)
    first = limit.settings[0]
    if first.verdict == "fails":
        return Answer(curve, f"{curve} is not known to hold at any setting: {limit.after_words()}.", False)
    lucky = list(takewhile(lambda setting: setting.successes == setting.runs, limit.settings))
    if not lucky:
        return Answer(curve, f"{curve} is not known to hold at any setting: {limit.after_words()}.")
    last = lucky[-1]
    named, share = f"{curve} {last.point}".strip(), share_of_rate(run, on, last.rate)
    held = "held in its only run" if last.runs == 1 else f"held in all of its {last.runs} runs"
    return Answer(curve, f"{named} {held} at {share}, too few to tell; at least {last.more_runs} more would tell.")


def _ranked(run: RunResult, column: Column, found: list[Ranking]) -> Answers:
    """found: the column's rankings, over all sequences first where there are several."""
    on = _on(run)
    ranking = next((each for each in found if each.sequence == on), None)
    what = f"by {column.label}" if column.metric.role == "task" else f"by {column.label} alone, as no task was measured"
    basis = f"Judged {what}, {where(on)}"
    if ranking is not None and ranking.ranked:
        basis += f", {ranking.units} {' and '.join(ranking.of)}; better and worse are significant at {SURE}"
        if ranking.too_few_on:
            basis += f". {sequences_are_samples(ranking)}"
    for sentence in () if ranking is None else uninformative(ranking):
        basis += f". {sentence.removesuffix('.')}"
    placed = {} if ranking is None else {ranked.curve: ranked for ranked in ranking.ranked}
    curves = [*placed, *(curve for curve in _curves(run) if curve not in placed)]
    best_on = _best_on(found)
    said = []
    for curve in curves:
        parts = [*_compared(run, ranking, placed.get(curve)), _spanned(run, on, curve, column)]
        if curve in best_on and len(placed[curve].ahead_of if curve in placed else ()) < len(placed) - 1:
            parts.insert(0, f"better than all others {best_on[curve]}")
        if ranking is not None and curve in ranking.left_out:
            parts.append(f"not compared: {ranking.left_out[curve]}")
        said.append(Answer(curve, f"{curve}: {'; '.join(filter(None, parts))}."))
    return Answers(f"{basis}.", tuple(said), column.label)


def _best_on(found: list[Ranking]) -> dict[str, str]:
    """On which sequences a curve is significantly better than all others there, in words."""
    alone = [ranking for ranking in found if ranking.sequence != POOLED]
    names: dict[str, list[str]] = defaultdict(list)
    for ranking in alone:
        for ranked in ranking.ranked:
            if len(ranked.ahead_of) == len(ranking.ranked) - 1:
                names[ranked.curve].append(ranking.sequence)
    return {
        curve: f"on {' and on '.join(those)} alone" if len(those) <= 2 else f"on {len(those)} of {len(alone)} sequences"
        for curve, those in names.items()
    }


def _spanned(run: RunResult, on: str, curve: str, column: Column) -> str:
    """From where to where the values and the rates of a curve's settings reach, on average over sequences."""
    assert run.rate is not None
    keys = zip(run.wide["codec"], run.wide["setting"], strict=True)
    settings = run.wide[[run.curves[key].curve == curve for key in keys]].groupby("setting", sort=False)
    means = settings[[column.name, run.rate.name]].agg(_mean_of_all)
    rows = means.dropna()
    if rows.empty:
        unmeasured = [f"“{part.label}”" for part in (column, run.rate) if means[part.name].isna().all()]
        return f"{' and '.join(unmeasured) or 'rate and value of one setting'} not measured"
    values = np.sort(rows[column.name].to_numpy(float)) * column.factor
    rates = np.sort(rows[run.rate.name].to_numpy(float))
    unit = f" {column.unit}" if column.unit not in ("", "1") else ""
    raw = baseline_rate(run, on)
    if raw is not None and rates[0] > 0 and rates[-1] < raw[1]:
        spent = f"{_reaching('1/{:.0f}', raw[1] / rates)} of {raw[0]}'s rate"
    else:
        spent = f"{_reaching('{:.3g}', rates * run.rate.factor)} {run.rate.unit}"
    return f"{_reaching('{:.3g}', values)}{unit} at {spent}".replace("inf", "∞")


def _mean_of_all(values: pd.Series[float]) -> float:
    """The mean, which is missing where one value is."""
    return float(values.mean(skipna=False))


def _reaching(form: str, values: np.ndarray) -> str:
    low, high = form.format(values[0]), form.format(values[-1])
    return low if low == high else f"{low} to {high}"


def _compared(run: RunResult, ranking: Ranking | None, ranked: Ranked | None) -> Iterator[str]:
    """What is known of a curve beside the others."""
    if ranking is None:
        yield "no other codec was measured at its rates" if len(_curves(run)) > 1 else "nothing to compare it with"
        return
    if ranked is None:
        return
    others = {other.curve: other for other in ranking.ranked if other is not ranked}
    behind = [name for name, other in others.items() if ranked.curve in other.ahead_of]
    beyond = ranking.not_compared(ranked.curve)
    level = [name for name in others if name not in (*ranked.ahead_of, *behind, *beyond)]
    for words, names in (
        ("better than", ranked.ahead_of),
        ("not significantly different from", level),
        ("worse than", behind),
    ):
        if names:
            all_of_them = len(names) == len(others) > 2
            yield f"{words} {f'all {len(names)} others' if all_of_them else ', '.join(names)}"
    if beyond:
        yield f"not compared with {', '.join(beyond)} ({NO_COMMON_RATE})"
    for anchor in ranking.anchors[:1]:
        found = ranking.evidence(ranked.curve, anchor)
        if found and anchor in (*ranked.ahead_of, *behind):
            yield less_rate(found, anchor)


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
