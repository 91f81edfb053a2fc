"""The matrix that is made for a recording."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from recordings import pictures, tum

from codecbench.core.contracts.errors import ParamsError, Unsupported
from codecbench.core.engine.planning.matrix import matrix_from
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.warm_up import WarmUp
from codecbench.core.kernels.manifest import Entry
from codecbench.trial.pace import Pace
from codecbench.trial.trial import open_recording
from codecbench.trial.trial_matrix import trial_matrix


class Machine:
    """What is measured of the machine, said instead."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.pace, self.kernels = Pace(1.0, 0.0), WarmUp()
        monkeypatch.setattr("os.cpu_count", lambda: 2)
        monkeypatch.setattr("codecbench.trial.trial_matrix.measure_pace", lambda *_: self.pace)
        monkeypatch.setattr("codecbench.trial.trial_matrix.kernels_to_compile", lambda *_: self.kernels)


@pytest.fixture(autouse=True)
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    return Machine(monkeypatch)


def codecs_of(text: str) -> set[str]:
    return {entry.setting.name for entry in matrix_from(text).codecs}


def test_it_is_a_matrix_with_raw_and_what_was_asked_for(tmp_path: Path) -> None:
    pictures(tmp_path / "my pictures", [f"{n}.png" for n in range(12)])
    made = trial_matrix(installed(), open_recording(tmp_path / "my pictures"), ["jpeg:5..90"])
    matrix = matrix_from(made.text)
    plan = make_plan(matrix)
    assert plan.name == "try-my-pictures"
    assert codecs_of(made.text) == {"raw", "jpeg"}
    (search,) = matrix.searches
    assert search.objective is None, "what is sought is the coarsest that passes"
    assert [setting.params["quality"] for setting in search.settings] == [
        5, 11, 17, 23, 29, 35, 41, 48, 54, 60, 66, 72, 78, 84, 90
    ]  # fmt: skip
    assert made.settings == 1 + 4, "so many of them bisection tries"
    assert [entry.frames for entry in plan.sequences] == [12]
    assert made.aim == "quality"
    assert "--fov" not in made.choices[0]


def test_every_usual_codec_that_is_installed_can_be_planned(tmp_path: Path) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(12)])
    made = trial_matrix(installed(), open_recording(tmp_path))
    assert codecs_of(made.text) == {"raw", "jpeg", "jpeg2000", "webp", "h264"}
    assert [len(search.settings) for search in matrix_from(made.text).searches] == [15, 15, 15, 15]


def test_values_that_were_named_are_tried_as_they_are(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    made = trial_matrix(
        installed(), open_recording(tmp_path), ["jpeg:10", "webp:5|40", "jpeg2000:ratio=9..90/3,layers=1|2"]
    )
    assert not matrix_from(made.text).searches
    assert made.settings == 1 + 1 + 2 + 6


def test_video_codecs_are_left_out_if_sizes_differ(tmp_path: Path) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(6)])
    pictures(tmp_path, ["6.png"], size=(48, 32))
    made = trial_matrix(installed(), open_recording(tmp_path))
    assert codecs_of(made.text) == {"raw", "jpeg", "jpeg2000", "webp"}
    assert any("(h264)" in choice for choice in made.choices)
    assert "h264" in trial_matrix(installed(), open_recording(tmp_path), ["h264"]).text


def test_a_field_of_view_is_suggested_where_it_would_help(tmp_path: Path) -> None:
    recording = open_recording(tum(tmp_path / "walk", calibrated=False))
    for frames, helps in ((149, False), (150, True)):
        made = trial_matrix(installed(), replace(recording, frames=frames), ["jpeg:10"], minutes=60)
        assert ("--fov DEGREES" in made.choices[0]) is helps


def test_too_few_frames_are_counted(tmp_path: Path) -> None:
    recording = open_recording(tum(tmp_path / "walk"))
    assert "2 frames are" in trial_matrix(installed(), recording, ["jpeg:10"]).choices[0]
    assert "1 frame is" in trial_matrix(installed(), replace(recording, frames=1), ["jpeg:10"]).choices[0]
    (_, few) = trial_matrix(installed(), recording, ["jpeg:10"], minutes=0.001).choices
    assert few.startswith("all 2 frames")
    assert "0.001 minutes" in few


def test_a_long_recording_is_cut_to_the_minutes_with_a_note(tmp_path: Path) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(400)])
    recording = replace(open_recording(tmp_path), width=640, height=480)
    frames = [trial_matrix(installed(), recording, ["jpeg:10"], minutes=minutes).frames for minutes in (0.2, 0.6, 60)]
    assert frames[0] == 10
    assert 10 < frames[1] < 400
    assert frames[2] == 400
    cut = trial_matrix(installed(), recording, ["jpeg:10"], minutes=0.6)
    assert f"the first {frames[1]} of 400 frames" in cut.choices[-1]
    assert make_plan(matrix_from(cut.text)).sequences[0].frames == frames[1]
    assert cut.minutes == 1


def test_a_recording_that_is_cut_has_as_many_frames_whatever_is_left_out(tmp_path: Path) -> None:
    pictures(tmp_path, [f"{n:04}.png" for n in range(300)], size=(640, 480))
    recording = open_recording(tmp_path, params={"start": 100, "stride": 2, "skip": [104]})
    made = trial_matrix(installed(), recording, ["jpeg:10"], "quality", minutes=0.1)
    (sequence,) = make_plan(matrix_from(made.text)).sequences
    assert (made.frames, sequence.frames) == (10, 10)
    assert sequence.dataset.params["stop"] == 121


def test_a_machine_that_is_busy_gets_less(tmp_path: Path, machine: Machine) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(400)])
    recording = replace(open_recording(tmp_path), width=640, height=480)
    frames = []
    for machine.pace in (Pace(1.0, 0.0), Pace(2.0, 0.0), Pace(1.0, 20.0)):
        made = trial_matrix(installed(), recording, ["jpeg:10"], minutes=1)
        frames.append(made.frames)
        assert made.estimated_s <= 60.0
    assert frames[1] < frames[0]
    assert frames[2] < frames[0], "frames take long to be read"


def test_codecs_are_left_out_where_time_is_short(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    recording = replace(open_recording(tum(tmp_path / "walk")), frames=500, width=640, height=480)
    counts = [len(codecs_of(trial_matrix(installed(), recording, minutes=minutes).text)) for minutes in (30, 4, 1)]
    assert counts == [5, 4, 3], "raw is one of them"
    short = trial_matrix(installed(), recording, minutes=1)
    assert any(choice.endswith(": jpeg2000, webp") for choice in short.choices)
    assert short.frames == 150
    for fact in ("150 of 500 frames", "about 1 minute ("):
        assert fact in short.choices[-1]
    assert codecs_of(trial_matrix(installed(), recording, ["webp:1..9", "jpeg:1..9"], minutes=1).text) > {"webp"}


def test_codecs_with_memory_get_two_seconds(tmp_path: Path) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(100)])
    for codec, frames in (("jpeg:10", 10), ("h264:crf=30", 60)):
        assert trial_matrix(installed(), open_recording(tmp_path), [codec], "speed", minutes=0.01).frames == frames


def test_compiling_is_in_the_estimate_only_where_kernels_have_to_be_compiled(tmp_path: Path, machine: Machine) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    warm = trial_matrix(installed(), open_recording(tmp_path), ["jpeg:10"])
    machine.kernels = WarmUp(
        {Entry("module:kernel", "fast", "f8", 10.0): (), Entry("module:other", "fast", "f8", 14.0): ()}
    )
    machine.pace = Pace(1.0, 0.0)
    cold = trial_matrix(installed(), open_recording(tmp_path), ["jpeg:10"])
    assert (warm.compiles, cold.compiles) == (False, True)
    workers = matrix_from(cold.text).run.workers
    assert cold.estimated_s - warm.estimated_s == pytest.approx(24.0 / workers)


def test_each_aim_has_its_evaluators(tmp_path: Path) -> None:
    recording = open_recording(tum(tmp_path / "walk"))
    for aim, evaluators in (
        ("tracking", {"quality", "localization", "trajectory", "timing"}),
        ("quality", {"quality", "features", "timing"}),
        ("speed", {"quality", "timing"}),
    ):
        made = trial_matrix(installed(), recording, ["jpeg:10"], aim)  # type: ignore[arg-type]
        assert {cell.evaluator.name for cell in make_plan(matrix_from(made.text)).cells} == evaluators
    blind = trial_matrix(installed(), replace(recording, has_ground_truth=False), ["jpeg:1..95"], "tracking", 30)
    assert "localization" not in blind.text, "it needs ground truth"
    assert len(matrix_from(blind.text).searches[0].settings) == 7, "four runs a setting take their time"
    assert trial_matrix(installed(), recording).aim == "quality", "two frames are too few for SLAM"


def test_tracking_without_a_camera_asks_for_one(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    with pytest.raises(Unsupported, match="--fov DEGREES"):
        trial_matrix(installed(), open_recording(tmp_path), aim="tracking")
    made = trial_matrix(installed(), open_recording(tmp_path, fov_deg=70.0), ["jpeg:10"], aim="tracking")
    assert "no ground truth" in made.choices[-1]


def test_a_wrong_value_is_an_error_of_the_option(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    with pytest.raises(ParamsError, match=r"^--codec jpeg:500: quality: "):
        trial_matrix(installed(), open_recording(tmp_path), ["jpeg:500"])
