"""What the documentation shows is what there is."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest
from project import DOCS, ROOT, THIRD_PARTY

from codecbench.core.contracts.evaluator import Evaluator
from codecbench.core.contracts.hooks import KINDS
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import Drawing, Line, View
from codecbench.core.engine.planning.matrix import read_matrix


@pytest.mark.parametrize(
    "name",
    ["pyproject.toml", "codecbench_posterize/__init__.py", "codecbench_posterize/codec.py", "tests/test_posterize.py"],
)
def test_the_tutorial_shows_the_package_that_is_tested(name: str) -> None:
    assert (THIRD_PARTY / "posterize" / name).read_text() in (DOCS / "writing-a-codec.md").read_text()


@pytest.mark.parametrize(
    "name", ["codecbench_edges/__init__.py", "codecbench_edges/evaluator.py", "tests/test_edges.py"]
)
def test_the_guide_shows_the_evaluator_that_is_tested(name: str) -> None:
    assert (THIRD_PARTY / "edges" / name).read_text() in (DOCS / "writing-an-evaluator.md").read_text()


@pytest.mark.parametrize("of", [Metric, Evaluator, View, Line, Drawing])
def test_every_field_that_an_evaluator_may_declare_is_explained(of: type) -> None:
    page = (DOCS / "writing-an-evaluator.md").read_text()
    names = {name for name in inspect.get_annotations(of) if not name.startswith("_")}
    for name in names - {"params_type"}:
        assert re.search(rf"\b{name}\b", page), name


def test_every_hook_is_documented() -> None:
    page = (DOCS / "writing-a-codec.md").read_text()
    for kind in KINDS:
        assert f"codecbench_{kind}s" in page


def test_the_matrix_of_the_page_is_a_matrix(tmp_path: Path) -> None:
    (block,) = re.findall(r"```yaml\n(.*?)```", (DOCS / "matrix.md").read_text(), re.DOTALL)
    (tmp_path / "matrix.yaml").write_text(block)
    matrix = read_matrix(tmp_path / "matrix.yaml")
    assert len(matrix.codecs) == 12


@pytest.mark.parametrize("path", sorted((ROOT / "examples").glob("*.yaml")), ids=lambda path: path.name)
def test_every_example_is_a_matrix(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CODECBENCH_DATA", "/data")
    read_matrix(path)
