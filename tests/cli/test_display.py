"""What a run says of itself meanwhile."""

from __future__ import annotations

import io
import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest

from codecbench.cli.display import Display, Screen, describe_progress, format_clock
from codecbench.core.engine.running.progress import Progress
from codecbench.core.engine.storage.record import Record

MOMENT = Progress(90, 10, 4, 16, 7, 2, elapsed_s=30.0, remaining_s=200.0)


def test_cells_are_counted_and_nothing_else() -> None:
    """As `codecbench status` counts them: jobs of encoding are no cells."""
    assert describe_progress(MOMENT) == "14 of 90 cells, about 3:20 left, 2 without a result"
    assert (
        describe_progress(Progress(90, 0, 0, 16, 0, 0, 0.0, None, compiling="compiling 3 of 9"))
        == "0 of 90 cells, compiling 3 of 9"
    )


@pytest.mark.parametrize(("seconds", "text"), [(0, "0:00"), (59.6, "1:00"), (61, "1:01"), (3725, "1:02:05")])
def test_a_clock(seconds: float, text: str) -> None:
    assert format_clock(seconds) == text


class TwoMinutes(threading.Event):
    """The end of a display, for which two minutes are waited at once and the third for as long as it takes."""

    def __init__(self) -> None:
        super().__init__()
        self.waited_s: list[float | None] = []
        self.over = threading.Event()

    def wait(self, timeout: float | None = None) -> bool:
        self.waited_s.append(timeout)
        if len(self.waited_s) <= 2:
            return False
        self.over.set()
        return super().wait()


def test_without_a_terminal_what_is_measured_first_is_said_at_once(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COLUMNS", raising=False)
    with Display(Screen(file=io.StringIO()), keep_going=True) as shown:
        shown.show(MOMENT)
        assert capsys.readouterr().err == ""
        for measured in ("jpeg quality=30: PSNR 30.3 dB", "", "jpeg quality=75: PSNR 34.7 dB"):
            shown.show(replace(MOMENT, measured=measured))
    said = "14 of 90 cells, about 3:20 left, 2 without a result; jpeg quality=30: PSNR 30.3 dB"
    assert capsys.readouterr().err.splitlines() == [said]


def test_without_a_terminal_a_line_is_said_every_minute(capsys: pytest.CaptureFixture[str]) -> None:
    shown, shown._ended = Display(Screen(file=io.StringIO()), keep_going=True), TwoMinutes()
    shown.show(MOMENT)
    with shown:
        assert shown._ended.over.wait(300)
    assert shown._lines is not None
    shown._lines.join(300)
    assert shown._ended.waited_s == [60.0] * 3
    assert capsys.readouterr().err.splitlines() == ["14 of 90 cells, about 3:20 left, 2 without a result"] * 2


@pytest.mark.parametrize("options", [{"quiet": True}, {"force_terminal": True}])
def test_nothing_of_that_on_a_terminal_or_when_told_to_be_quiet(
    options: dict[str, bool], capsys: pytest.CaptureFixture[str]
) -> None:
    before = set(threading.enumerate())
    shown, shown._ended = Display(Screen(file=io.StringIO(), **options), keep_going=True), TwoMinutes()
    with shown:
        shown.show(MOMENT)
        begun = set(threading.enumerate()) - before
    for thread in begun:
        thread.join(300)
    assert shown._ended.waited_s == []
    assert capsys.readouterr().err == ""


def test_a_reason_is_printed_once_and_then_counted(capsys: pytest.CaptureFixture[str]) -> None:
    cell = SimpleNamespace(
        sequence=SimpleNamespace(name="walk"), codec=SimpleNamespace(name="jpeg", label="quality=5"),
        evaluator=SimpleNamespace(name="quality"), repeat=0,
    )  # fmt: skip
    with Display(Screen(file=io.StringIO()), keep_going=True) as shown:
        for reason in ("damaged", "no memory", *["damaged"] * 3):
            record = Record("a", "failed", reason)
            shown.show(replace(MOMENT, cell=cell, record=record))  # type: ignore[arg-type]
    *first, others = capsys.readouterr().err.splitlines()
    name = "walk | jpeg quality=5 | quality #0"
    assert first == [f"failed: {name}: damaged", f"failed: {name}: no memory"]
    assert (others.split()[0], others.endswith(name)) == ("3", True)
