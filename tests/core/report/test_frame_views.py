"""Views of frames: what is cut out, exact differences, and marks in the pixels of the part that is shown."""

from __future__ import annotations

import base64
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from report_runs import coded_frame

from codecbench.core.contracts.view import KeypointOverlay
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.report.pictures import _marker, frame_view


def picture(uri: str) -> np.ndarray:
    content = base64.b64decode(uri.partition(",")[2])
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)


def test_the_middle_is_shown_at_one_pixel_a_pixel() -> None:
    coded = coded_frame(height=240, width=320)
    view = frame_view(coded, 7, (200, 150))
    assert (view.index, view.width, view.height) == (7, 200, 150)
    shown = coded.original.image[45:195, 60:260].astype(int)
    assert np.abs(picture(view.original).astype(int) - shown).mean() < 2
    difference = 4 * (shown & 0xF0) - 4 * shown + 128
    assert np.abs(picture(view.difference).astype(int) - difference).mean() < 8


def test_a_frame_that_is_smaller_is_shown_whole() -> None:
    view = frame_view(coded_frame(height=100, width=120), 0, (200, 150))
    assert (view.width, view.height) == (120, 100)


def test_marks_are_those_inside_and_the_note_is_of_all() -> None:
    places = np.array([[60.0, 45.0], [160.4, 120.0], [259.0, 194.0], [59.0, 45.0], [0.0, 0.0]])
    view = frame_view(
        coded_frame(), 0, (200, 150), KeypointOverlay(places, np.array([True, False, True, False, True]), "3 of 5")
    )
    assert view.kept == [0, 0, 199, 149]
    assert view.lost == [100, 75]
    assert view.note == "3 of 5"
    assert frame_view(coded_frame(), 0, (200, 150)).note == ""


def test_the_first_evaluator_marks_that_can_and_is_installed() -> None:
    settings = [PluginSetting("evaluator", name, "1") for name in ("gone", "quality", "features")]
    offers = {"gone": ["marks"], "quality": [], "features": ["marks"]}
    declared = {"evaluators": {name: {"offers": offered} for name, offered in offers.items()}}
    results = [SimpleNamespace(cell=SimpleNamespace(evaluator=setting)) for setting in settings]
    run: Any = SimpleNamespace(results=results, plan=SimpleNamespace(declared=declared))
    assert _marker(run) == settings[2]
