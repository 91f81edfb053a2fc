"""What a run says of itself meanwhile."""

from __future__ import annotations

import io
import time

import pytest

from codecbench.cli import display
from codecbench.cli.display import Display, clock, spoken
from codecbench.cli.screen import Screen
from codecbench.core.engine.running.progress import Progress

MOMENT = Progress(90, 10, 4, 16, 7, 2, elapsed_s=30.0, remaining_s=200.0)


def test_cells_are_counted_and_nothing_else() -> None:
    """As `codecbench status` counts them: jobs of encoding are no cells."""
    assert spoken(MOMENT) == "14 of 90 cells, about 3:20 left, 2 without a result"
    assert (
        spoken(Progress(90, 0, 0, 16, 0, 0, 0.0, None, compiling="compiling 3 of 9"))
        == "0 of 90 cells, compiling 3 of 9"
    )


@pytest.mark.parametrize(("seconds", "text"), [(0, "0:00"), (59.6, "1:00"), (61, "1:01"), (3725, "1:02:05")])
def test_a_clock(seconds: float, text: str) -> None:
    assert clock(seconds) == text


def test_without_a_terminal_a_line_is_said_from_time_to_time(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(display, "_LINE_EVERY_S", 0.05)
    with Display(Screen(file=io.StringIO()), keep_going=True) as shown:
        shown.show(MOMENT)
        time.sleep(0.3)
    said = capsys.readouterr().err.splitlines()
    assert 2 <= len(said) <= 7
    assert set(said) <= {"starting", "14 of 90 cells, about 3:20 left, 2 without a result"}
    assert said[-1] != "starting"
    time.sleep(0.1)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("options", [{"quiet": True}, {"force_terminal": True}])
def test_nothing_of_that_on_a_terminal_or_when_told_to_be_quiet(
    options: dict[str, bool], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(display, "_LINE_EVERY_S", 0.05)
    with Display(Screen(file=io.StringIO(), **options), keep_going=True) as shown:
        shown.show(MOMENT)
        time.sleep(0.2)
    assert capsys.readouterr().err == ""
