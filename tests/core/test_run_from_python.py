"""A run as scripts and notebooks hold it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import codecbench
from codecbench import MatrixError, ParamsError, PluginError, RunResult

MATRIX: dict[str, Any] = {
    "version": 1,
    "name": "python",
    "sequences": [{"use": "synthetic", "params": {"stop": 2, "scale": 0.15}}],
    "codecs": ["raw", {"use": "jpeg", "params": {"quality": {"grid": [10, 50, 90]}}},
               {"use": "jpeg2000", "params": {"cr_percent": {"grid": [80, 90, 97]}}}],
    "evaluators": ["quality"],
    "run": {"workers": 1},
}  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> RunResult:
    return codecbench.run(MATRIX, out=tmp_path_factory.mktemp("python") / "run")


def test_a_dict_is_a_matrix_and_stays_in_the_run_folder(run: RunResult) -> None:
    assert len(run.results) == 7
    again = codecbench.run(run.folder / "matrix.yaml", out=run.folder)
    assert [result.cell.id for result in again.results] == [result.cell.id for result in run.results]


def test_a_wrong_dict_is_told_as_a_wrong_file_is() -> None:
    with pytest.raises(MatrixError, match=r"codecs\[0\].*'jpg'"):
        codecbench.run({**MATRIX, "codecs": ["jpg"]})
    with pytest.raises(MatrixError, match="numbers and paths"):
        codecbench.run({**MATRIX, "codecs": [object()]})


def test_it_shows_itself_in_three_lines_and_as_a_table(run: RunResult) -> None:
    first, second, third = repr(run).splitlines()
    assert first == f"run python in {run.folder}"
    assert [second.partition(" on ")[0], *re.findall(r"\d+ frames|synthetic", second)] == [
        "raw, jpeg, jpeg2000", "synthetic", "2 frames",
    ]  # fmt: skip
    assert third == "cells: 7 ok"
    table = run._repr_html_()
    assert table.count("<tr") == 8
    assert "quality=10" in table
    assert "<td>∞</td>" in table
    assert "inf" not in table


def test_figures_are_found_by_words(run: RunResult) -> None:
    figure = run.plot("rate-psnr")
    (axes,) = figure.axes
    assert "PSNR" in axes.get_ylabel()
    assert run.plot().axes
    with pytest.raises(ParamsError, match=r"'rate-nonsense'.*-psnr_"):
        run.plot("rate-nonsense")
    with pytest.raises(ParamsError, match=r"sequence 'other'; .* synthetic"):
        run.plot("rate-psnr", "other")


def test_the_best_is_a_sentence_a_codec_or_at_a_rate_the_codec(run: RunResult) -> None:
    said = run.best()
    assert {answer.curve for answer in said.answers} == {"jpeg", "jpeg2000"}  # type: ignore[union-attr]
    rates = run.wide[run.wide["codec"] == "jpeg"]["quality.rate_bpp.mean"].sort_values().tolist()
    taken = run.best(float(np.sqrt(rates[0] * rates[1])))
    assert taken.curve in ("jpeg", "jpeg2000")  # type: ignore[union-attr]
    with pytest.raises(ParamsError, match=r"ranked at that rate"):
        run.best(1e6)


@pytest.mark.parametrize("wrong", ["quality.psnr_gray_db", True, 0.0, -1.0, float("nan"), float("inf"), [0.5]])
def test_what_is_no_rate_is_answered_with_what_is(run: RunResult, wrong: Any) -> None:
    with pytest.raises(ParamsError, match=rf"^best\({re.escape(repr(wrong))}\): .* above 0 in bit/px"):
        run.best(wrong)


def test_frames_come_back_as_they_were_coded(run: RunResult) -> None:
    coded = run.frames("jpeg", "quality=10")
    jpeg = codecbench.codec("jpeg", quality=10)
    for frame in coded:
        bitstream = jpeg.encode(frame.original.image)  # type: ignore[attr-defined]
        assert bitstream == frame.bitstream
        assert np.array_equal(jpeg.decode(bitstream), frame.decoded)  # type: ignore[attr-defined]
    assert [frame.bitstream for frame in run.frames("jpeg", {"quality": 10})] == [frame.bitstream for frame in coded]
    with pytest.raises(ParamsError, match=r"^jpeg quality=11 .* of raw, jpeg quality=10"):
        run.frames("jpeg", {"quality": 11})
    with pytest.raises(ParamsError, match=r"^jpeg ratio=10 is"):
        run.frames("jpeg", {"ratio": 10})
    with pytest.raises(ParamsError, match=r"of jpeg quality=10, .*=50"):
        run.frames("jpeg")
    with pytest.raises(ParamsError, match="say which of"):
        run.frames("jpeg", "quality=11")


def test_a_report_is_written(run: RunResult, tmp_path: Path) -> None:
    assert run.report(tmp_path / "page.html").stat().st_size > 10_000


def test_a_codec_by_its_name() -> None:
    assert codecbench.codec("jpeg", quality=7).params.quality == 7
    with pytest.raises(ParamsError, match=r"qualty: .*'quality'"):
        codecbench.codec("jpeg", qualty=7)
    with pytest.raises(ParamsError, match=r"quality: .* 100; got 700"):
        codecbench.codec("jpeg", quality=700)
    with pytest.raises(PluginError, match=r"'jpge'.* 'jpeg'"):
        codecbench.codec("jpge")
    with pytest.raises(ParamsError, match=r"one value .* quality: "):
        codecbench.codec("jpeg", quality=[10, 20])


def test_dir_lists_what_a_user_needs_and_nothing_else() -> None:
    listed = dir(codecbench)
    assert {"run", "open_run", "trial", "codec", "bundle", "Codec", "FrameEvaluator"} <= set(listed)
    assert not {"annotations", "Any", "import_module", "TYPE_CHECKING", "core", "cli"} & set(listed)
    assert all(hasattr(codecbench, name) for name in listed)
