"""The page in Chromium: nothing empty, overlapping or cut off, no network, every control works without a complaint."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import pytest
from chromium import CHROMIUM, Browser, Page, browser
from report_runs import TRACEBACK, report_frames, report_run
from told import numbers

from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.page import render

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: no browser to open the page in"),
]

RUNS: Final[dict[str, dict[str, Any]]] = {
    "one codec": {"codecs": 1},
    "four codecs": {"codecs": 4, "sequences": 2},
    "sixty codecs": {"codecs": 60, "sequences": 3, "settings": 1},
    "failed cells": {"codecs": 4, "failed": 5},
    "no trajectories": {"codecs": 3, "paths": False},
    "quality only": {"codecs": 3, "paths": False, "task": False},
    "stills and streams": {"codecs": 4, "noted": "holds back 3 frames (100 ms)"},
}
BAR_BYTES: Final = 12_000_000
BAR_S: Final = 2.0
WIDTHS: Final = (1400, 390)

PROBE: Final = (Path(__file__).parent / "probe.js").read_text(encoding="utf-8")
AXE: Final = files("axe_core_python").joinpath("axe.min.js").read_text(encoding="utf-8")
SERIOUS: Final = """axe.run({resultTypes: ['violations']}).then((found) => found.violations
  .filter((one) => ['serious', 'critical'].includes(one.impact))
  .map((one) => `${one.id}: ${one.help}: ${one.nodes.slice(0, 3).map((node) => node.html).join(' | ')}`))"""
EVERYTHING: Final = (Path(__file__).parent / "everything.js").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def chromium(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def written(path: Path, **asked: Any) -> tuple[RunResult, str]:
    """The run, and the address of its page."""
    run = report_run(**asked)
    path.write_text(render(run, lambda _: report_frames(run)), encoding="utf-8")
    return run, path.as_uri()


def opened(chromium: Browser, address: str, width: int = 1400) -> Page:
    page = chromium.page()
    page.call("Page.setDownloadBehavior", behavior="deny")
    page.size(width, 900)
    page.open(address)
    return page


def count(page: Page, selector: str) -> int:
    """How many parts of the page a selector finds."""
    found: int = page.evaluate(f"document.querySelectorAll({json.dumps(selector)}).length")
    return found


def text_of(page: Page, selector: str) -> str:
    found: str = page.evaluate(f"document.querySelector({json.dumps(selector)}).textContent")
    return found


@pytest.mark.parametrize("name", RUNS)
def test_nothing_is_empty_overlaps_or_is_cut_off_and_every_control_works(
    name: str, chromium: Browser, tmp_path: Path
) -> None:
    _, address = written(tmp_path / "page.html", **RUNS[name])
    for width in WIDTHS:
        page = opened(chromium, address, width)
        assert page.evaluate(PROBE) == []
        heads = page.evaluate("[...document.querySelectorAll('#table-head th')].map((head) => head.dataset.name)")
        assert ("notes" in heads) == ("noted" in RUNS[name])
        page.screenshot(tmp_path / f"{width}.png", whole=True)
        assert (tmp_path / f"{width}.png").stat().st_size > 10_000
        tried = page.evaluate(EVERYTHING)
        assert {"csv", "json", "search", "preset", "y"} <= set(tried) | {found.split("=")[0] for found in tried}
        assert page.complaints == []
        assert [found for found in page.requests if not found.startswith(("data:", "blob:")) and found != address] == []
        page.close()


@pytest.mark.parametrize("name", ["four codecs", "failed cells", "stills and streams"])
@pytest.mark.parametrize("width", WIDTHS)
def test_axe_finds_nothing_serious(name: str, width: int, chromium: Browser, tmp_path: Path) -> None:
    """axe-core's rules for people who see, hear or move otherwise, its "serious" and "critical" ones."""
    page = opened(chromium, written(tmp_path / "page.html", **RUNS[name])[1], width)
    page.evaluate(AXE)
    assert page.evaluate(SERIOUS) == []
    page.evaluate("document.querySelectorAll('button').forEach((button) => button.textContent = '')")
    assert any(found.startswith("button-name") for found in page.evaluate(SERIOUS)), "it sees what is wrong"
    page.close()


BOTTOM: Final = "document.querySelector({!r}).getBoundingClientRect().bottom"
CUT: Final = """[...document.querySelectorAll('.whole')].filter((box) => box.scrollWidth > box.clientWidth + 1)
  .map((box) => box.getAttribute('aria-label'))"""
SMALL: Final = """[...document.querySelectorAll('a, button, summary, select, input')]
  .filter((node) => node.getClientRects().length && !node.closest('label.tick'))
  .map((node) => [node.outerHTML, node.getBoundingClientRect()])
  .filter(([, box]) => box.height < 24 || box.width < 24).map(([html]) => html)"""


def test_the_first_screen_has_the_answer_a_strip_of_each_codec_and_the_curve(chromium: Browser, tmp_path: Path) -> None:
    page = opened(chromium, written(tmp_path / "page.html", codecs=4)[1], 1280)
    page.size(1280, 800)
    assert page.evaluate(BOTTOM.format(".answer")) < page.evaluate(BOTTOM.format(".strips")) < 600
    top = page.evaluate("document.querySelector('#curve svg').getBoundingClientRect().top")
    assert top < 400
    assert count(page, ".strips > li") == 4
    swatches = count(page, ".strips [data-curve] > svg:first-child")
    assert swatches == 4
    phone = opened(chromium, page.evaluate("location.href"), 390)
    phone.size(390, 844)
    assert phone.evaluate(BOTTOM.format(".strips > li")) < 600
    first = phone.evaluate("document.querySelector('.strips > li').innerText")
    assert first.startswith("codec3 q=1.0 0.16 bpp, 20 % less")
    assert "coarser" in first.splitlines()[1]


@pytest.mark.parametrize("width", [1280, 390])
def test_no_table_of_codecs_hides_what_decides_and_fingers_hit_every_control(
    width: int, chromium: Browser, tmp_path: Path
) -> None:
    page = opened(chromium, written(tmp_path / "page.html", codecs=4, sequences=2)[1], width)
    page.evaluate("document.querySelectorAll('details').forEach((part) => { part.open = true; })")
    assert count(page, ".whole") > 2
    assert page.evaluate(CUT) == []
    assert page.evaluate(SMALL) == []


def test_a_key_opens_what_was_found_of_the_settings_of_a_strip(chromium: Browser, tmp_path: Path) -> None:
    page = opened(chromium, written(tmp_path / "page.html", codecs=2)[1])
    page.evaluate("[...document.querySelectorAll('nav a')].at(-1).focus()")
    page.press("Tab")
    focused = "document.activeElement"
    assert page.evaluate(f"{focused}.matches('.strips summary')")
    assert page.evaluate(f"getComputedStyle({focused}).outlineWidth") == "3px"
    page.press("Enter")
    listed = page.evaluate(f"[...{focused}.parentElement.querySelectorAll('li')].map((one) => one.innerText)")
    assert listed[0].startswith("q=4.0, 0.4 bpp: passes (4/4 ")
    assert numbers(listed[0]) == [4.0, 0.4, 4.0, 4.0, 51.0, 95.0]
    assert not count(page, ".strips [tabindex], .strips g[role]")


def test_on_paper_the_sentences_are_open_and_charts_keep_to_their_column(chromium: Browser, tmp_path: Path) -> None:
    page = opened(chromium, written(tmp_path / "page.html", codecs=2)[1])
    page.call("Emulation.setEmulatedMedia", media="print")
    drawn, size = page.evaluate(  # at once: a chart is drawn anew when its width has changed
        "(() => { dispatchEvent(new Event('beforeprint')); const svg = $('curve').firstChild;"
        " return [svg.getAttribute('viewBox'), `0 0 ${svg.getAttribute('width')} ${svg.getAttribute('height')}`]; })()"
    )
    assert page.evaluate("[...document.querySelectorAll('details.printed')].every((part) => part.open)")
    assert drawn == size
    shown = "document.querySelector({!r}).getClientRects().length > 0"
    assert [page.evaluate(shown.format(part)) for part in (".strips", "#curve", "nav", ".controls", "#look")] == [
        True, True, False, False, False,
    ]  # fmt: skip
    page.evaluate("dispatchEvent(new Event('afterprint'))")
    assert not page.evaluate("document.querySelector('details.printed').open")


def test_the_probe_finds_what_is_wrong(chromium: Browser, tmp_path: Path) -> None:
    page = opened(chromium, written(tmp_path / "page.html", codecs=2)[1])
    page.evaluate("document.querySelectorAll('#curve .line, #curve .point').forEach((part) => part.remove())")
    page.evaluate("document.querySelectorAll('#curve .tick.y').forEach((part) => part.remove())")
    page.evaluate("document.querySelector('#curve .axis').setAttribute('x', -50)")
    page.evaluate("$('search').style.width = '3000px'; $('search').style.maxWidth = 'none'")
    page.evaluate("fetch('https://example.invalid/').catch(() => 0)")
    faults = " ".join(page.evaluate(PROBE))
    for word in ("empty", "y axis with 0 numbers", "cut off", "beyond the window: INPUT search", "scrolls sideways"):
        assert word in faults
    assert "https://example.invalid/" in page.requests


def test_sixty_settings_on_three_sequences_are_small_and_soon_there(chromium: Browser, tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    _, address = written(path, **RUNS["sixty codecs"])
    assert path.stat().st_size < BAR_BYTES
    page = chromium.page()
    page.call("Performance.enable")
    page.open(address)
    assert count(page, "#table-body tr") == 3 * 61
    spent = {found["name"]: found["value"] for found in page.call("Performance.getMetrics")["metrics"]}
    assert spent["ProcessTime"] < BAR_S, "processor time, so that a busy machine does not count"


def test_a_key_sorts_without_losing_its_place_and_what_is_missing_stands_last(
    chromium: Browser, tmp_path: Path
) -> None:
    page = opened(chromium, written(tmp_path / "page.html", codecs=4, failed=4)[1])
    page.evaluate("[...document.querySelectorAll('.sort')].find((one) => one.textContent.includes('drift')).focus()")
    column = "[...document.querySelectorAll('#table-head th')].findIndex((one) => one.dataset.name.includes('drift'))"
    values = (
        f"((at) => [...document.querySelectorAll('#table-body tr')].map((row) => row.cells[at].textContent))({column})"
    )
    for direction in ("ascending", "descending"):
        page.press("Enter")
        sorted_by = page.evaluate("document.activeElement.closest('th').getAttribute('aria-sort')")
        assert sorted_by == direction
        found = page.evaluate(values)
        assert found[-4:] == ["–"] * 4
        numbers = [float(text) for text in found[:-4]]
        assert numbers == sorted(numbers, reverse=direction == "descending")


def test_a_click_on_a_point_shows_its_frames_and_its_path_and_the_address_keeps_it(
    chromium: Browser, tmp_path: Path
) -> None:
    _, address = written(tmp_path / "page.html", codecs=3)
    page = opened(chromium, address)
    page.evaluate("document.querySelectorAll('#curve .point')[4].dispatchEvent(new Event('click'))")
    asked = page.evaluate("JSON.parse(STATE.at)")
    assert page.evaluate("$('look-setting').value") == page.evaluate("STATE.at")
    assert count(page, "#curve .chosen") == 1
    page.evaluate("$('path-scrub').value = 130; $('path-scrub').dispatchEvent(new Event('input'))")
    assert "Frame 130: lost" in text_of(page, "#path-caption")
    told = page.evaluate("document.querySelector('#path-error svg').getAttribute('aria-label')")
    for share in ("tracked 90 %", "waiting 1 %", "lost 10 %"):
        assert share in told
    assert count(page, "#path-error .lane") == 3
    page.evaluate("$('path-scrub').value = 220; $('path-scrub').dispatchEvent(new Event('input'))")
    assert "frame 225" in text_of(page, "#frame-caption"), "the nearest frame that is stored"
    page.evaluate("$('frame-mode').value = 'difference'; $('frame-mode').dispatchEvent(new Event('change'))")
    assert count(page, "#frame-marks .lost") == 1
    again = opened(chromium, page.evaluate("location.href"))
    look = "JSON.parse($('look-setting').value)"
    assert again.evaluate(look) == asked
    assert again.evaluate("$('frame-mode').value") == "difference"
    assert "frame 225" in text_of(again, "#frame-caption")


def test_the_page_looks_at_the_setting_of_the_answer_which_the_curve_rings(chromium: Browser, tmp_path: Path) -> None:
    run, address = written(tmp_path / "page.html", codecs=3, sequences=2)
    assert str(run.answer).startswith("Use plain q=2.0")
    page = opened(chromium, address)
    look = "JSON.parse($('look-setting').value)"
    assert page.evaluate(look) == ["sequence0", "plain", "q=2.0"]
    rings = "[...document.querySelectorAll('#curve .ring')].map((ring) => JSON.parse(ring.parentNode.dataset.key)[1])"
    assert page.evaluate(rings) == ["plain", "codec1", "codec2"]
    assert "coarsest that passes" in text_of(page, "#legend")


def test_what_is_asked_is_a_line_where_the_curve_is_of_it(chromium: Browser, tmp_path: Path) -> None:
    page = opened(chromium, written(tmp_path / "page.html", codecs=1)[1])
    told = "[...document.querySelectorAll('#curve .asked + text')].map((text) => text.textContent)"
    assert page.evaluate(told) == []
    page.evaluate("DATA.asked[$('y').value] = { sequence0: 0.02 }; $('y').dispatchEvent(new Event('change'))")
    assert page.evaluate(told) == ["≤ 0.02 required"]
    assert page.evaluate(PROBE) == []


def test_points_are_one_stop_of_the_tab_key_and_arrows_go_between_them(chromium: Browser, tmp_path: Path) -> None:
    page = opened(chromium, written(tmp_path / "page.html", codecs=2)[1])
    assert count(page, "#curve .point") == 6
    assert count(page, "#curve .point[tabindex='0']") == 1
    label = "document.activeElement.getAttribute('aria-label')"
    page.evaluate("document.querySelector('#curve .point').focus()")
    page.press("ArrowRight")
    assert page.evaluate(label).startswith("plain q=2.0, ")
    assert page.evaluate("document.querySelector('#curve .tip').textContent.startsWith('plain q=2.0\\n')")
    page.press("Enter")
    assert page.evaluate("STATE.at") == '["sequence0","plain","q=2.0"]'
    assert page.evaluate(label).startswith("plain q=2.0, "), "the point keeps the focus where the curve is drawn again"
    page.press("ArrowLeft")
    page.press("ArrowLeft")
    assert page.evaluate(label).startswith("codec1 q=4.0, "), "after the first comes the last"
    page.press("Tab")
    assert not page.evaluate("Boolean(document.activeElement.closest('#curve'))")
    assert count(page, "#curve .tip") == 0


def test_a_failure_opens_to_its_traceback_which_stays_text(chromium: Browser, tmp_path: Path) -> None:
    page = opened(chromium, written(tmp_path / "page.html", codecs=2, failed=1)[1])
    page.evaluate("document.querySelector('.failure summary').click()")
    assert text_of(page, ".failure pre") == TRACEBACK
    assert "it fails" in text_of(page, ".failure p")


def test_an_axis_is_numbered_wherever_its_values_lie(chromium: Browser, tmp_path: Path) -> None:
    """From 6.3 to 7.1 there is no 1, 2 or 5 times a power of ten."""
    page = opened(chromium, written(tmp_path / "page.html", codecs=1)[1])
    assert page.evaluate("ticksOf(6.3, 7.1, true, 6)") == [6.4, 6.6, 6.8, 7]
    assert page.evaluate("ticksOf(0.9, 5.5, true, 6)") == [1, 2, 5]
    assert page.evaluate("ticksOf(0.001, 1000, true, 8)") == [0.001, 0.01, 0.1, 1, 10, 100, 1000]
    assert page.evaluate("ticksOf(-1, 1, false, 4)") == [-1, -0.5, 0, 0.5, 1]
    assert page.evaluate("apart([0.1, 0.15, 0.2, 0.25, 0.3], scaleOf([0.1, 0.3], true, [0, 200]), 40)") == [
        0.1,
        0.15,
        0.2,
        0.3,
    ]
    assert page.evaluate("apart([1.00000001, 1.00000002], scaleOf([1, 1.1], false, [0, 1e9]), 1)") == [1.00000001]
    assert page.evaluate("ticksOf(0.000081, 0.000083, true, 5)") == [0.000081, 0.0000815, 0.000082, 0.0000825, 0.000083]
