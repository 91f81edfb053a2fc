"""What is shown first of a run whose answer is known: the curve, the settings of the answer, and what is asked."""

from __future__ import annotations

from dataclasses import replace

import pytest
from measured_runs import METRICS, cell_result, run_of
from report_runs import report_run

from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.metric import Metric
from codecbench.core.report.answers import answers
from codecbench.core.report.page_data import page_data
from codecbench.core.report.pictures import _select
from codecbench.core.report.views import Pick, answer_picks, bounds, first_view

LOCATED = Metric("located", "1", "higher", "", role="task", headline=True, enough=0.9)


def tracked(codec: str, rate: float, held: list[float], sequence: str = "s") -> list[CellResult]:
    """A setting of a rate, and its runs that hold or not, each with a drift."""
    sized = cell_result(codec, rate, "size", own={("bits", ""): [rate]}, sequence_name=sequence)
    runs = [
        cell_result(
            codec, rate, "track", own={("held", ""): [value], ("drift", ""): [0.1]}, repeat=repeat,
            sequence_name=sequence,
        )
        for repeat, value in enumerate(held)
    ]  # fmt: skip
    return [sized, *runs]


def located(codec: str, rate: float, share: float) -> CellResult:
    found = cell_result(codec, rate, "locate", own={("located", ""): [share] * 4})
    return replace(found, metrics={**METRICS, "located": LOCATED})


def shown_first(run: RunResult) -> tuple[str, str]:
    data = page_data(run)
    view = first_view(run)
    assert view is not None
    first = data["presets"][data["first"]]
    assert (first["x"], first["y"]) == (view.x.name, view.y.name)
    return first["x"], first["y"]


def test_the_curve_that_is_shown_first_is_of_what_most_settings_have_a_value_of() -> None:
    """A search tracks at the edge alone."""
    rates = (1.0, 2.0, 3.0)
    sizes = [tracked("plain", rate, [])[0] for rate in rates]
    everywhere = [located("plain", rate, 0.95) for rate in rates]
    edge = tracked("plain", 1.0, [1.0] * 4)[1:]
    assert shown_first(run_of(*sizes, *edge, *everywhere)) == ("size.bits.mean", "locate.located.mean")
    tie = [cell for rate in rates for cell in tracked("plain", rate, [1.0] * 4)[1:]]
    assert shown_first(run_of(*sizes, *tie, *everywhere)) == ("size.bits.mean", "track.drift.median")
    assert first_view(run_of(*tracked("plain", 1.0, [])[:1])) is None


def test_the_setting_of_the_answer_comes_first_and_then_that_of_each_codec() -> None:
    run = run_of(
        *tracked("raw", 24.0, [1.0] * 4),
        *(cell for rate, held in ((4.0, 1.0), (2.0, 1.0), (1.0, 0.0)) for cell in tracked("plain", rate, [held] * 4)),
        *(cell for rate, held in ((3.0, 1.0), (0.5, 1.0)) for cell in tracked("good", rate, [held] * 4)),
        *tracked("bad", 5.0, [0.0] * 4),
    )
    assert answers(run).sentence.startswith("Use good q=0.5")
    assert answer_picks(run) == [Pick("good", "q=0.5", True), Pick("plain", "q=2.0", True), Pick("bad", "q=5.0", False)]


def test_a_setting_for_all_sequences_is_picked_by_what_it_does_on_all() -> None:
    cells = [
        cell
        for sequence, held in (("one", 1.0), ("two", 0.0))
        for cell in [*tracked("plain", 2.0, [1.0] * 4, sequence), *tracked("plain", 1.0, [held] * 4, sequence)]
    ]
    assert answer_picks(run_of(*cells)) == [Pick("plain", "q=2.0", True)]


def test_where_nothing_passes_the_nearest_is_picked_and_else_the_finest_of_the_first() -> None:
    none = [*tracked("bad", 5.0, [0.0] * 4), *tracked("bad", 9.0, [0.0] * 4)]
    likely = [*tracked("plain", 2.0, [1.0] * 2), *tracked("other", 1.0, [1.0] * 2)]
    run = run_of(*none, *likely)
    assert "nearest is other q=1.0" in answers(run).sentence
    assert [pick.setting for pick in answer_picks(run)] == ["q=1.0", "q=2.0", "q=9.0"]
    assert answer_picks(run_of(*none)) == [Pick("bad", "q=9.0", False)]


def test_what_is_asked_is_known_of_each_column_and_sequence() -> None:
    cells = [*tracked("plain", 1.0, [1.0] * 4), located("plain", 1.0, 0.95)]
    assert bounds(run_of(*cells)) == {"locate.located.mean": {"s": 0.9}}
    assert bounds(report_run(1, task=False)) == {}, "raw's score is infinite"
    raw, plain = (cell_result(codec, 1.0, "look", own={("bits", ""): [1.0], ("drift", ""): [value]})
                  for codec, value in (("raw", 0.5), ("plain", 0.7)))  # fmt: skip
    assert bounds(run_of(raw, plain)) == {"look.drift.median": {"s": 1.0}}


@pytest.mark.parametrize(
    ("count", "kept"), [(6, [0, 1, 2, 3, 4, 5]), (4, [0, 2, 4, 5]), (3, [0, 2, 4]), (2, [2, 4]), (1, [4]), (0, [])]
)
def test_settings_of_the_answer_stay_where_not_all_fit(count: int, kept: list[int]) -> None:
    names = [("plain", f"q={number}") for number in range(6)]
    assert _select(names, count, [names[4], ("gone", ""), names[2]]) == kept
