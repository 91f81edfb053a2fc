"""What the page says before anybody looks closer, as text."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import numpy as np
from measured_runs import METRICS
from report_runs import report_run

from codecbench.core.analysis.run_result import RunResult
from codecbench.core.contracts.view import Drawing, FrameTimeline, Line, TimelineRow
from codecbench.core.report.page import render
from codecbench.core.report.page_data import maps


def page(run: RunResult) -> str:
    return render(run, lambda _: {"frames": [], "originals": []})


def section(html: str, name: str) -> str:
    found = re.search(rf'<section id="{name}".*?</section>', html, re.S)
    assert found is not None
    return found[0]


def test_what_was_done_to_sequences_stands_below_the_answer_and_its_strips() -> None:
    run = report_run(2)
    said = ("the first 300 of 1,000 frames are used", *(f"note {number}" for number in range(5)))
    entries = tuple(replace(entry, notes=said) for entry in run.plan.sequences)
    html = page(replace(run, plan=replace(run.plan, sequences=entries)))
    below = section(html, "answer").partition('<div class="axis"')[2]
    noted = below.index("sequence0: the first 300 of 1,000 frames are used.")
    assert noted < below.index("note 0.") < below.index("<details", noted) < below.index("note 1.")
    assert html.count("are used.") == 1


def test_a_caveat_stands_once_in_every_section_that_shows_its_evaluator() -> None:
    cautious = {**METRICS, "drift": replace(METRICS["drift"], caveat="a guess")}
    run = report_run(2)
    html = page(replace(run, results=tuple(replace(result, metrics=cautious) for result in run.results)))
    for name in ("answer", "verdict", "summary", "map-0"):
        assert section(html, name).count("drift: a guess.") == 1, name


def test_a_frame_that_was_lost_among_ten_thousand_is_on_the_timeline_and_the_largest_error_too() -> None:
    count = 10_000
    lost, errors = np.zeros(count, bool), np.full(count, 0.01)
    lost[4321], errors[1234], errors[5000:] = True, 0.5, np.nan
    rows = (TimelineRow("there", "good", ~lost), TimelineRow("lost", "bad", lost))
    timeline = FrameTimeline(np.arange(count), None, errors, "m", rows, "how far off")
    run = report_run(1)
    drawing = Drawing((Line("truth", "truth", np.zeros((2, 2))),), "a way", timeline=timeline)
    drawn = [replace(r, drawing=lambda: drawing) if r.cell.evaluator.name == "track" else r for r in run.results]
    found = maps(replace(run, results=tuple(drawn)))[0]["drawings"][0]["timeline"]
    assert len(json.dumps(found)) < 10_000
    assert (found["x"], found["last"], len(found["frames"])) == (None, count - 1, len(found["errors"]))
    assert max(error for error in found["errors"] if error is not None) == 0.5
    assert found["errors"][-1] is None
    there, gone = found["rows"]
    assert (gone["name"], gone["tone"], gone["share"]) == ("lost", "bad", 1 / count)
    assert gone["levels"].strip("0") == "1"
    assert gone["levels"].index("1") == 4321 * len(gone["levels"]) // count
    assert set(there["levels"]) == {"9"}


def test_failures_of_one_setting_are_told_apart_by_their_repeat() -> None:
    run = report_run(2)
    broken = tuple(
        replace(result, status="failed", reason="it fails")
        if (result.cell.codec.name, result.cell.codec.label, result.cell.evaluator.name) == ("plain", "q=1.0", "track")
        else result
        for result in run.results
    )
    titles = re.findall(r'<details class="failure"><summary>(.*?)</summary>', page(replace(run, results=broken)))
    assert [title.split(", ") for title in titles] == [
        ["sequence0", "plain q=1.0", "track", f"repeat {repeat}: failed"] for repeat in range(4)
    ]


def test_times_of_several_machines_are_not_to_be_compared() -> None:
    one, two = ({"machine": {"cpu": name}} for name in ("an abacus", "an engine"))
    run = report_run(1)
    assert "this machine only" in page(replace(run, environments={"a": one, "b": one}))
    html = page(replace(run, environments={"a": one, "b": two}))
    assert "2 machines: do not" in html
    assert "this machine only" not in html
