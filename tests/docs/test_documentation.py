"""What the documentation shows is what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from project import DOCS, ROOT, THIRD_PARTY

from codecbench.core.contracts.hooks import KINDS
from codecbench.core.engine.planning.matrix import read_matrix


@pytest.mark.parametrize(
    "name",
    ["pyproject.toml", "codecbench_posterize/__init__.py", "codecbench_posterize/codec.py", "tests/test_posterize.py"],
)
def test_the_tutorial_shows_the_package_that_is_tested(name: str) -> None:
    assert (THIRD_PARTY / "posterize" / name).read_text() in (DOCS / "writing-a-codec.md").read_text()


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
