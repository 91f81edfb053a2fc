"""The matrix that is made for a recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from recordings import pictures, tum

from codecbench.core.contracts.errors import MatrixError, Unsupported
from codecbench.core.engine.planning.matrix import matrix_from
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.registry import installed
from codecbench.trial.trial import looked_at
from codecbench.trial.trial_matrix import trial_matrix


def test_it_is_a_matrix_with_raw_and_what_was_asked_for(tmp_path: Path) -> None:
    pictures(tmp_path / "my pictures", [f"{n}.png" for n in range(12)])
    made = trial_matrix(installed(), looked_at(tmp_path / "my pictures"), ["jpeg:5..90"])
    plan = make_plan(matrix_from(made.text))
    assert plan.name == "try-my-pictures"
    assert {(cell.codec.name, cell.codec.label) for cell in plan.cells} == {
        ("raw", ""), *(("jpeg", f"quality={quality}") for quality in (5, 10, 21, 44, 90)),
    }  # fmt: skip
    assert made.settings == 6
    assert [entry.frames for entry in plan.sequences] == [12]
    assert made.aim == "quality"
    assert "--fov" not in made.choices[0]


def test_every_usual_codec_that_is_installed_can_be_planned(tmp_path: Path) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(12)])
    made = trial_matrix(installed(), looked_at(tmp_path))
    cells = make_plan(matrix_from(made.text)).cells
    assert {"raw", "jpeg", "jpeg2000", "webp", "h264"} == {cell.codec.name for cell in cells}
    assert not [cell.unsupported for cell in cells if cell.unsupported]


def test_codecs_with_memory_are_left_out_where_sizes_differ(tmp_path: Path) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(6)])
    pictures(tmp_path, ["6.png"], size=(48, 32))
    made = trial_matrix(installed(), looked_at(tmp_path))
    assert {cell.codec.name for cell in make_plan(matrix_from(made.text)).cells} == {"raw", "jpeg", "jpeg2000", "webp"}
    assert "codecs with memory (h264) are left out: they need pictures of one size" in made.choices
    assert "h264" in trial_matrix(installed(), looked_at(tmp_path), ["h264"]).text


def test_a_field_of_view_is_suggested_where_it_would_help(tmp_path: Path) -> None:
    recording = looked_at(tum(tmp_path / "walk", calibrated=False))
    for frames, helps in ((149, False), (150, True)):
        made = trial_matrix(installed(), replace(recording, frames=frames), ["jpeg:10"], minutes=60)
        assert ("--fov DEGREES" in made.choices[0]) is helps


def test_one_and_few_are_said_as_they_are(tmp_path: Path) -> None:
    recording = looked_at(tum(tmp_path / "walk"))
    assert "2 frames are too few" in trial_matrix(installed(), recording, ["jpeg:10"]).choices[0]
    assert "1 frame is too few" in trial_matrix(installed(), replace(recording, frames=1), ["jpeg:10"]).choices[0]
    (_, few) = trial_matrix(installed(), recording, ["jpeg:10"], minutes=0.001).choices
    assert few == "all 2 frames are needed, which may take more than about 0.001 minutes (--minutes)"


def test_a_long_recording_is_cut_to_the_minutes_and_that_is_said(tmp_path: Path) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(400)])
    recording = looked_at(tmp_path)
    frames = [trial_matrix(installed(), recording, ["jpeg:10"], minutes=minutes).frames for minutes in (0.5, 0.6, 60)]
    assert frames[0] == 10
    assert 10 < frames[1] < 400
    assert frames[2] == 400
    cut = trial_matrix(installed(), recording, ["jpeg:10"], minutes=0.6)
    assert f"the first {frames[1]} of 400 frames" in cut.choices[-1]
    assert make_plan(matrix_from(cut.text)).sequences[0].frames == frames[1]


def test_compiling_is_in_the_estimate_only_where_kernels_have_to_be_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    estimates: dict[bool, float] = {}
    for cold in (False, True):
        found = ["a kernel"] if cold else []
        monkeypatch.setattr("codecbench.trial.trial_matrix.kernels_to_compile", lambda *_, found=found: found)
        made = trial_matrix(installed(), looked_at(tmp_path), ["jpeg:10"])
        assert made.compiles == cold
        estimates[cold] = made.estimated_s
    assert estimates[True] - estimates[False] == pytest.approx(30.0)


def test_what_the_pictures_are_for_says_what_is_measured(tmp_path: Path) -> None:
    recording = looked_at(tum(tmp_path / "walk"))
    for aim, evaluators in (
        ("tracking", {"quality", "trajectory", "timing"}),
        ("quality", {"quality", "features", "timing"}),
        ("speed", {"quality", "timing"}),
    ):
        made = trial_matrix(installed(), recording, ["jpeg:10"], aim)  # type: ignore[arg-type]
        assert {cell.evaluator.name for cell in make_plan(matrix_from(made.text)).cells} == evaluators
    few = trial_matrix(installed(), recording)
    assert few.aim == "quality"
    assert "too few for SLAM" in few.choices[0]


def test_tracking_without_a_camera_is_answered_with_what_to_give(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    with pytest.raises(Unsupported, match="--fov DEGREES"):
        trial_matrix(installed(), looked_at(tmp_path), aim="tracking")
    made = trial_matrix(installed(), looked_at(tmp_path, fov_deg=70.0), ["jpeg:10"], aim="tracking")
    assert "stand in" in made.choices[-1]


def test_a_wrong_value_is_an_error_of_the_matrix(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    with pytest.raises(MatrixError, match=r"codecs\[1\].params.quality.*100"):
        trial_matrix(installed(), looked_at(tmp_path), ["jpeg:500"])
