"""docs/architecture.md names files that exist, every room, and the import rules."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
from project import DOCS, ROOT, TESTS

PAGE = (DOCS / "architecture.md").read_text()
NAMED = sorted(set(re.findall(r"`((?:codecbench|docs|tests|examples)/[\w./-]*|pyproject\.toml)`", PAGE)))
ROOMS = sorted(
    str(path.relative_to(ROOT))
    for folder in ("", "core", "core/engine", "slam", "plugins")
    for path in (ROOT / "codecbench" / folder).iterdir()
    if (path / "__init__.py").exists() and path.name not in ("core", "plugins")
)


@pytest.mark.parametrize("name", NAMED)
def test_every_path_that_is_named_exists(name: str) -> None:
    path = ROOT / name
    assert path.is_dir() if name.endswith("/") else path.is_file()


@pytest.mark.parametrize("room", ROOMS)
def test_every_room_is_described(room: str) -> None:
    assert f"| `{room}/` |" in PAGE


def test_functions_that_are_named_are_where_it_says() -> None:
    places = re.findall(r"`(\w+)` in `([\w./]+\.py)`", PAGE)
    assert places
    for name, path in places:
        assert re.search(rf"\b{name}\b", (ROOT / path).read_text()), f"{name} in {path}"


@pytest.mark.parametrize("edit", ["a metric", "a codec with", "another keyframe policy", "a column", "a threshold"])
def test_the_usual_edits_are_in_the_table(edit: str) -> None:
    (row,) = re.findall(rf"^\| {edit} .*$", PAGE, re.MULTILINE)
    assert any(Path(ROOT / name).exists() for name in re.findall(r"`(codecbench/[\w./]+)`", row))


def test_pytest_as_the_readme_gives_it_finds_every_folder_of_tests() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["pytest"]["ini_options"]
    with_tests = {path.relative_to(ROOT).parts[1] for path in TESTS.glob("*/**/test_*.py")}
    assert set(settings["testpaths"]) == {f"tests/{folder}" for folder in with_tests - {"benchmarks"}}
