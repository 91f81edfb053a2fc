"""Which codec to take at which rate, as a run decides it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from codecbench.core.analysis.limits import POOLED
from codecbench.core.analysis.ranking import Ranked, Ranking, rankings
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.formatting import setting_words
from codecbench.core.report.tables import table

Heads = tuple[str, ...]
RATES: Final = (0.2, 0.5, 1.0)
"""At which a codec is chosen, in bits a pixel."""


def order(run: RunResult, heads: Heads) -> Iterator[str]:
    """Codecs in order of each task over all rates that they share, over all sequences together."""
    rows, agreements = [], []
    for ranking in rankings(run, brief=True):
        for ranked in ranking.ranked:
            places = str(ranked.first) if ranked.first == ranked.last else f"{ranked.first}–{ranked.last}"
            beside = next((ranked.bd_rates[anchor] for anchor in ranking.anchors if anchor in ranked.bd_rates), None)
            rate = "–" if beside is None or beside.reason else f"{beside.percent:+.0f} %"
            ahead = ", ".join(ranked.ahead_of) or "–"
            rows.append([ranking.column.label, places, ranked.curve, ranked.group, rate, ahead])
        values = ranking.rank_correlation.values()
        agreements.append(f"{ranking.column.label}, {sum(values) / len(values):.2f} ({min(values):.2f} at least)")
    yield table(heads, rows)
    yield f"How well the order on a sequence is foretold by the others', as Kendall's tau: {'; '.join(agreements)}."


def every_task(run: RunResult, heads: Heads) -> Iterator[str]:
    """Every task over all sequences together."""
    rows = [[ranking.column.label, *row(ranking)] for ranking in decided(run) if ranking.sequence == POOLED]
    yield table(heads, sorted(rows, key=lambda cells: cells[0]))


def every_sequence(run: RunResult, heads: Heads) -> Iterator[str]:
    """The first task on each sequence."""
    first = next(ranking.column for ranking in decided(run))
    of_first = [ranking for ranking in decided(run) if ranking.column == first and ranking.sequence != POOLED]
    rows = [[ranking.sequence, *row(ranking)] for ranking in of_first]
    yield table(heads, sorted(rows, key=lambda cells: cells[0]))


def decided(run: RunResult) -> list[Ranking]:
    """Rankings at each of RATES, by task and then by rate."""
    assert run.rate is not None
    found = [ranking for rate in RATES for ranking in rankings(run, at=rate / run.rate.factor)]
    columns = list(dict.fromkeys(ranking.column for ranking in found))
    return sorted(found, key=lambda ranking: columns.index(ranking.column))


def row(ranking: Ranking) -> list[str]:
    """The rate, what to take and its value, who is worse, as good, or not there, how well the order agrees."""
    taken = ranking.recommended
    assert ranking.rate is not None
    return [
        f"{ranking.rate:g} bit/px",
        f"`{taken.curve} {setting_words(taken)}`",
        shown(ranking, taken),
        ", ".join(taken.ahead_of) or "–",
        ", ".join(ranking.as_good) or "–",
        ", ".join(ranking.left_out) or "–",
        f"{sum(ranking.rank_correlation.values()) / len(ranking.rank_correlation):.2f}"
        if ranking.rank_correlation
        else "–",
    ]


def shown(ranking: Ranking, ranked: Ranked) -> str:
    assert ranked.value is not None
    return f"{ranked.value * ranking.column.factor:.3g}"
