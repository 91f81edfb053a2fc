"""A matrix is checked as a whole, and every problem is reported with its place."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from codecbench.core.contracts.errors import MatrixError
from codecbench.core.engine.planning.matrix import Matrix, read_matrix
from codecbench.core.engine.planning.plan import make_plan

GOOD = """
version: 1
name: small
sequences:
  - use: synthetic
    params: {frames: 3}
codecs:
  - raw
  - use: jpeg
    params: {quality: {grid: [10, 50]}, optimize: true}
  - use: multilevel
    params:
      qf: {range: [5, 15, 5]}
      levels: {grid: [1, 2]}
evaluators: [quality]
run: {workers: 2, timeout_s: 60, memory_mb: 1024, seed: 7}
"""


def read(tmp_path: Path, text: str) -> Matrix:
    path = tmp_path / "matrix.yaml"
    path.write_text(text)
    return read_matrix(path)


def errors(tmp_path: Path, text: str) -> list[str]:
    with pytest.raises(MatrixError) as caught:
        read(tmp_path, text)
    return [line.removeprefix(str(tmp_path / "matrix.yaml") + ":") for line in str(caught.value).splitlines()]


def test_axes_span_a_grid_and_labels_say_the_difference(tmp_path: Path) -> None:
    matrix = read(tmp_path, GOOD)
    labels = [(entry.setting.name, entry.setting.label) for entry in matrix.codecs]
    assert labels == [
        ("raw", ""),
        ("jpeg", "quality=10"),
        ("jpeg", "quality=50"),
        *[("multilevel", f"qf={qf} levels={levels}") for qf in (5, 10, 15) for levels in (1, 2)],
    ]
    assert (matrix.run.workers, matrix.run.timeout_s, matrix.run.seed) == (2, 60.0, 7)
    assert matrix.run.executor.name == "local"


def test_a_matrix_says_who_bd_rates_are_against(tmp_path: Path) -> None:
    def references(text: str) -> dict[str, str]:
        declared = make_plan(read(tmp_path, text)).declared["codecs"]
        return {name: meant["reference"] for name, meant in declared.items()}

    usual = {"raw": "baseline", "jpeg": "anchor", "multilevel": ""}
    assert references(GOOD) == usual
    assert references(GOOD + "anchors: [multilevel]\n") == {"raw": "baseline", "jpeg": "", "multilevel": "anchor"}
    assert references(GOOD + "anchors: [multilevel, jpeg]\n") == usual | {"multilevel": "anchor"}


@pytest.mark.parametrize(
    ("anchors", "words"),
    [
        ("jpeg", r"anchors: .* got 'jpeg'"),
        ("[]", r"anchors: .* got \[\]"),
        ("[jepg]", r"anchors\[0\]: 'jepg' .*'jpeg'"),
        ("[jpeg, raw]", r"anchors\[1\]: raw .*baseline"),
    ],
)
def test_who_cannot_be_an_anchor(anchors: str, words: str, tmp_path: Path) -> None:
    (problem,) = errors(tmp_path, GOOD + f"anchors: {anchors}\n")
    assert re.search(words, problem), problem


def test_the_only_setting_of_a_codec_is_labelled_by_what_is_not_default(tmp_path: Path) -> None:
    text = GOOD.replace("{grid: [10, 50]}", "10")
    assert read(tmp_path, text).codecs[1].setting.label == "quality=10 optimize=yes"


def test_labels_of_a_codec_leave_out_what_nobody_wrote(tmp_path: Path) -> None:
    several = "{qf: {grid: [5, 10]}}", "{qf: 5, profile: context}"
    text = GOOD.replace("  - raw\n", "".join(f"  - {{use: multilevel, params: {params}}}\n" for params in several))
    labels = [entry.setting.label for entry in read(tmp_path, text).codecs if entry.setting.name == "multilevel"]
    assert labels[:3] == ["qf=5", "qf=10", "profile=context qf=5"]
    assert len(set(labels)) == len(labels)


def test_settings_that_mean_the_same_are_one(tmp_path: Path) -> None:
    text = GOOD.replace("grid: [10, 50]", "grid: [10, 50, 10]").replace("  - raw\n", "  - raw\n  - use: raw\n")
    assert len(read(tmp_path, text).codecs) == len(read(tmp_path, GOOD).codecs)


def test_yaml_is_version_1_2(tmp_path: Path) -> None:
    matrix = read(tmp_path, GOOD.replace("name: small", "name: no").replace("timeout_s: 60", "timeout_s: 1e3"))
    assert matrix.name == "no"
    assert matrix.run.timeout_s == 1000.0


def test_paths_expand_and_start_at_the_matrix_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MATRIX_TEST", "/elsewhere")
    monkeypatch.setenv("HOME", "/home/somebody")

    def path(value: str) -> str:
        text = GOOD.replace("use: synthetic\n    params: {frames: 3}", f"use: folder\n    params: {{path: '{value}'}}")
        return str(read(tmp_path, text).sequences[0].setting.params["path"])

    assert path("pictures") == str(tmp_path / "pictures")
    assert path("${MATRIX_TEST}/pictures") == "/elsewhere/pictures"
    assert path("~/pictures") == "/home/somebody/pictures"


def test_an_unset_variable_is_named(tmp_path: Path) -> None:
    unset = "${NOT_SET_AT_ALL}"
    text = GOOD.replace("use: synthetic\n    params: {frames: 3}", f"use: folder\n    params: {{path: '{unset}/x'}}")
    (line,) = errors(tmp_path, text)
    assert f"{unset} is not set" in line
    assert line.startswith("6:20: sequences[0].params.path")


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("version: 1", "version: 2", "2:10: version: must be 1; got 2"),
        ("version: 1\n", "", "version: must be 1; got None"),
        ("name: small", "name: a b", "3:7: name: 'a b' "),
        ("codecs:", "codec:", "7:1: codec: unknown; did you mean 'codecs'?"),
        ("use: jpeg", "use: jpg", "9:10: codecs[1].use: no codec "),
        ("use: jpeg", "use: jpg", "'jpg'; did you mean 'jpeg'?"),
        ("use: jpeg", "uses: jpeg", "9:5: codecs[1]: must be a name"),
        ("[10, 50]", "[10, 140]", "10:35: codecs[1].params.quality.grid[1]: "),
        ("[10, 50]", "[10, 140]", "to 100; got 140"),
        ("quality", "qualty", "10:14: codecs[1].params.qualty: unknown; "),
        ("[5, 15, 5]", "[5, 15, 0]", "must be [first, last, step > 0]"),
        ("grid: [1, 2]", "grid: []", "14:22: codecs[2].params.levels.grid: must be a list"),
        ("{grid: [1, 2]}", "{gird: [1, 2]}", "; did you mean `levels: {grid: [1, 2]}`?"),
        ("{range: [5, 15, 5]}", "{Ranges: [5, 15, 5]}", "did you mean `qf: {range: [5, 15, 5]}`?"),
        ("{grid: [10, 50]}", "[10, 50]", "write `quality: {grid: [10, 50]}`"),
        ("evaluators: [quality]", "evaluators: []", "15:13: evaluators: "),
        ("evaluators: [quality]", "evaluators: quality", "15:13: evaluators: "),
        ("workers: 2", "workers: 0", "16:16: run.workers: "),
        ("timeout_s: 60", "timeout_s: .inf", "run.timeout_s: "),
        ("workers: 2", "worker: 2", "16:7: run.worker: unknown; "),
        ("seed: 7", "seed: 7, executor: nowhere", "run.executor.use: no executor "),
        (
            "    params: {frames: 3}",
            "    parms: {frames: 3}",
            "6:5: sequences[0].parms: unknown; ",
        ),
        ("params: {frames: 3}", "params: 3", "6:13: sequences[0].params: "),
        ("seed: 7}", "seed: 7}\nanchors: jpeg", "17:10: anchors: "),
        ("seed: 7}", "seed: 7}\nanchors: [jpeg, raw]", "anchors[1]: raw is the baseline"),
        ("seed: 7}", "seed: 7", "not valid YAML"),
        ("name: small", "name: small\nname: again", "not valid YAML"),
    ],
)
def test_a_problem_is_reported_at_its_place(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in GOOD
    found = errors(tmp_path, GOOD.replace(old, new, 1))
    assert any(expected in line for line in found), found


def test_all_problems_are_reported_at_once_in_order(tmp_path: Path) -> None:
    text = (
        GOOD.replace("use: jpeg", "use: jpg")
        .replace("levels: {grid: [1, 2]}", "levels: 0")
        .replace("seed: 7", "sed: 7")
    )
    found = errors(tmp_path, text)
    assert [line.split(": ")[1] for line in found] == ["codecs[1].use", "codecs[2].params.levels", "run.sed"]


@pytest.mark.parametrize("text", ["", "- a\n- b\n", "just text", "42"])
def test_a_file_that_is_no_mapping_is_refused(tmp_path: Path, text: str) -> None:
    assert "a matrix is a mapping" in errors(tmp_path, text)[0]


def test_a_missing_file_and_a_binary_file_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MatrixError, match="no such file"):
        read_matrix(tmp_path / "nothing.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MatrixError, match="UTF-8"):
        read_matrix(tmp_path / "binary.yaml")
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(MatrixError, match="not a plain file"):
        read_matrix(tmp_path / "pipe.yaml")
