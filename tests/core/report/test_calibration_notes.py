"""Sequences that a run has under several calibrations: whose order turns, and that no answer counts the wrong ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_runs import cell_result, run_of
from told import numbers

from codecbench.core.analysis.ranking import rankings
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.report.answers import answers
from codecbench.core.report.page import render
from codecbench.core.report.picks import answer_tables, text_to_paste
from codecbench.core.report.tables import calibration_notes, notes

SCATTER = np.array([0.98, 1.03, 0.99, 1.01])


def errors(codec: str, sequence: str, drifts: np.ndarray, q: float = 1.0, held: float = 1.0) -> list[CellResult]:
    """A setting of rate q, and the errors in metres of its runs from each start; a NaN is a run without a path."""
    track = [
        cell_result(codec, q, "track", own={("drift", ""): [drift], ("held", ""): [held]}, repeat=repeat,
                    sequence_name=sequence)
        for repeat, drift in enumerate(drifts)
    ]  # fmt: skip
    return [cell_result(codec, q, "size", own={("bits", ""): [q]}, sequence_name=sequence), *track]


def road(*cells: list[CellResult]) -> RunResult:
    """A run of these cells, in which `road-k1...` is `road` under another calibration."""
    run = run_of(*(cell for group in cells for cell in group))
    entries = tuple(
        replace(entry, fingerprint=entry.name, as_calibrated="" if entry.name == "road" else "road")
        for entry in run.plan.sequences
    )
    return replace(run, plan=replace(run.plan, sequences=entries))


def both(sequence: str, raw: float, coarse: float, scatter: np.ndarray = SCATTER) -> list[CellResult]:
    return [
        *errors("raw", sequence, raw * scatter[::-1], 24.0),
        *errors("plain", sequence, coarse * scatter),
        *errors("plain", sequence, raw * 1.5 * scatter, 2.0),
    ]


def test_an_order_that_is_reversed_is_named_with_its_numbers() -> None:
    run = road(both("road", 22.0, 9.4), both("road-k1+0.01", 8.9, 32.0), both("road-k1-0.01", 51.0, 50.0))
    values, order = calibration_notes(run)
    assert values.startswith("road-k1+0.01, road-k1-0.01: road ")
    for fact in ("drift of raw: 22 m on road,", "8.9 m on road-k1+0.01", "51 m on road-k1-0.01"):
        assert fact in values
    better, _, worse = order.partition(" worse ")
    assert "plain q=1.0 is better" in better
    assert "road (9.4 against 22 m)" in better
    assert "road-k1+0.01 (32 against 8.9 m)" in worse
    assert notes(run)[:2] == calibration_notes(run)
    pages = text_to_paste(run, answer_tables(run), "markdown"), render(run, lambda _: {"frames": [], "originals": []})
    told = calibration_notes(run)[1].partition("(")[0]
    assert all(page.count(told) == 1 for page in pages)


def test_of_many_orders_that_turn_the_first_are_named() -> None:
    def many(sequence: str, factor: float) -> list[CellResult]:
        coarse = [errors("plain", sequence, factor * SCATTER, q) for q in (1.0, 2.0, 3.0, 4.0, 5.0)]
        return [*errors("raw", sequence, SCATTER[::-1], 24.0), *(cell for cells in coarse for cell in cells)]

    found = calibration_notes(road(many("road", 2.0), many("road-k1+0.01", 0.5)))
    assert ["plain q=3.0" in note for note in found] == [False, False, False, True, False]
    assert found[-1].startswith("road: ")
    assert "2 more settings" in found[-1]


def test_an_order_that_is_never_reversed_is_noted() -> None:
    run = road(both("road", 1.0, 3.0), both("road-k1+0.01", 4.0, 8.0), both("road-k1-0.01", 5.0, 7.0))
    values, order = calibration_notes(run)
    assert [numbers(part)[0] for part in values.rpartition(": ")[2].split(", ")] == [1.0, 4.0, 5.0]
    assert order.startswith("road: no order of raw")
    assert numbers(order) == [2.0, 2.0]


@pytest.mark.parametrize("lost", [False, True])
def test_an_order_within_the_scatter_over_starts_does_not_turn(lost: bool) -> None:
    """The medians turn, but not beyond the scatter; or but one start of a setting has a path."""
    scatter = np.array([0.98, np.nan, np.nan, np.nan]) if lost else np.array([0.2, 5.0, 0.4, 2.0])
    run = road(both("road", 1.0, 0.7, scatter), both("road-k1+0.01", 0.7, 1.0, scatter))
    _, order = calibration_notes(run)
    assert order.startswith("road: ")
    assert "than the scatter" in order


def test_wrong_calibrations_do_not_count_in_the_answer() -> None:
    def of(sequence: str, held: float) -> list[CellResult]:
        return [*errors("raw", sequence, SCATTER, 24.0), *errors("plain", sequence, SCATTER, held=held),
                *errors("plain", sequence, SCATTER, 2.0, held), *errors("good", sequence, SCATTER, held=held),
                *errors("good", sequence, SCATTER, 2.0, held)]  # fmt: skip

    alone, probed = road(of("road", 1.0)), road(of("road", 1.0), of("road-k1+0.01", 0.0))
    assert alone.as_calibrated is alone
    assert probed.as_calibrated.wide.equals(alone.wide)
    assert answers(probed) == answers(alone)
    assert answer_tables(probed) == answer_tables(alone)
    assert [ranking.sequence for ranking in rankings(probed)] == ["road"]
    assert calibration_notes(alone) == []
    assert set(probed.wide["sequence"]) == {"road", "road-k1+0.01"}


def test_a_wrong_calibration_alone_is_a_sequence_as_any_other() -> None:
    run = road(both("road-k1+0.01", 8.9, 32.0))
    assert run.as_calibrated is run
    assert calibration_notes(run) == []


def test_without_a_baseline_no_order_is_spoken_of() -> None:
    run = road(errors("plain", "road", SCATTER), errors("plain", "road-k1+0.01", SCATTER))
    (note,) = calibration_notes(run)
    assert note.startswith("road-k1+0.01: ")
    assert "road under another" in note
