"""What the page says before anybody looks closer, as text."""

from __future__ import annotations

import re
from dataclasses import replace

from measured_runs import METRICS
from report_runs import report_run

from codecbench.core.results.report.render import render
from codecbench.core.results.run_result import RunResult


def page(run: RunResult) -> str:
    return render(run, lambda _: {"frames": [], "originals": []})


def section(html: str, name: str) -> str:
    found = re.search(rf'<section id="{name}".*?</section>', html, re.S)
    assert found is not None
    return found[0]


def test_what_was_done_to_sequences_stands_below_the_title() -> None:
    run = report_run(2)
    said = ("the first 300 of 1,000 frames are used", *(f"note {number}" for number in range(5)))
    entries = tuple(replace(entry, notes=said) for entry in run.plan.sequences)
    html = page(replace(run, plan=replace(run.plan, sequences=entries)))
    header = html[html.index("<header>") : html.index("</header>")]
    assert "sequence0: the first 300 of 1,000 frames are used." in header
    assert header.index("note 2.") < header.index("<details") < header.index("note 3.")
    assert html.count("are used.") == 1


def test_a_caveat_stands_once_in_every_section_that_shows_its_evaluator() -> None:
    cautious = {**METRICS, "drift": replace(METRICS["drift"], caveat="a guess")}
    run = report_run(2)
    html = page(replace(run, results=tuple(replace(result, metrics=cautious) for result in run.results)))
    for name in ("answer", "verdict", "summary", "map-0"):
        assert section(html, name).count("drift: a guess.") == 1, name


def test_failures_of_one_setting_are_told_apart_by_their_repeat() -> None:
    run = report_run(2)
    broken = tuple(
        replace(result, status="failed", reason="it fails")
        if (result.cell.codec.name, result.cell.codec.label, result.cell.evaluator.name) == ("plain", "q=1.0", "track")
        else result
        for result in run.results
    )
    titles = re.findall(r'<details class="failure"><summary>(.*?)</summary>', page(replace(run, results=broken)))
    assert titles == [f"sequence0, plain q=1.0, track, repeat {repeat}: failed" for repeat in range(4)]


def test_times_of_several_machines_are_not_to_be_compared() -> None:
    one, two = ({"machine": {"cpu": name}} for name in ("an abacus", "an engine"))
    run = report_run(1)
    assert "times hold for this machine alone" in page(replace(run, environments={"a": one, "b": one}))
    html = page(replace(run, environments={"a": one, "b": two}))
    assert "2 machines: do not compare times" in html
    assert "times hold for this machine alone" not in html
