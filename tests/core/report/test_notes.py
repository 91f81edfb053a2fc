"""Notes on settings: one sentence for a curve, or for those of its settings that have it."""

from __future__ import annotations

from dataclasses import replace

from measured_runs import METRICS, cell_result, run_of

from codecbench.core.analysis.table import CellResult
from codecbench.core.report.tables import caveats, notes, sequence_notes, setting_notes


def noted(result: CellResult, *notes: str) -> CellResult:
    return replace(result, notes=notes)


def test_a_note_names_the_curve_or_its_settings() -> None:
    slow = "holds back 3 frames (100 ms)"
    cells = [noted(cell_result("slow", q, "look"), slow) for q in (1.0, 2.0)]
    cells += [noted(cell_result("slow", 1.0, "size"), slow)]
    cells += [cell_result("plain", q, "look") for q in (1.0, 2.0)]
    cells += [cell_result("some", 1.0, "look"), noted(cell_result("some", 2.0, "look"), slow, "hums")]
    assert setting_notes(run_of(*cells)) == [f"slow: {slow}.", f"some, q=2.0: {slow}.", "some, q=2.0: hums."]
    assert setting_notes(run_of(*cells[3:5])) == []


def test_a_note_on_several_sequences_is_one_sentence() -> None:
    run = run_of(*(cell_result("plain", 1.0, "look", sequence_name=name) for name in ("one", "two", "three")))
    part = "the first 5 of 9 frames are used"
    said = {"one": (part,), "two": ("dim", part), "three": ()}
    entries = tuple(replace(entry, notes=said[entry.name]) for entry in run.plan.sequences)
    noted = replace(run, plan=replace(run.plan, sequences=entries))
    assert sequence_notes(noted) == notes(noted) == [f"one, two: {part}.", "two: dim."]


def test_a_caveat_of_a_metric_stands_where_it_has_a_value() -> None:
    cautious = replace(METRICS["drift"], caveat="only guessed")
    cells = [cell_result("plain", q, "look", own={("drift", ""): [1.0]}) for q in (1.0, 2.0)]
    without = [cell_result("plain", q, "look", own={("score", ""): [1.0]}) for q in (1.0, 2.0)]
    told = [[replace(cell, metrics={**METRICS, "drift": cautious}) for cell in group] for group in (cells, without)]
    assert notes(run_of(*told[0])) == ["drift: only guessed."]
    assert caveats(run_of(*told[0]), ["look"]) == ["drift: only guessed."]
    assert caveats(run_of(*told[0]), ["size"]) == []
    assert notes(run_of(*told[1])) == []
    assert run_of(*told[0])._repr_html_().endswith("<p>drift: only guessed.</p>")
