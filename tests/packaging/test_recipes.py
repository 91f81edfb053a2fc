"""The Dockerfile and the recipe for conda agree with pyproject.toml."""

from __future__ import annotations

import re
import tomllib
from fnmatch import fnmatch
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from project import DOCS, ROOT

PYPROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT: dict[str, Any] = PYPROJECT["project"]
RECIPE: dict[str, Any] = yaml.safe_load((ROOT / "packaging/conda/recipe.yaml").read_text())
DOCKERFILE = (ROOT / "Dockerfile").read_text()
CONDA_NAMES = {"matplotlib": "matplotlib-base", "opencv-python-headless": "py-opencv"}
"""Packages that conda-forge calls otherwise: matplotlib without Qt, and OpenCV's Python package."""


def conda_requirement(text: str) -> str:
    wanted = Requirement(text)
    return f"{CONDA_NAMES.get(wanted.name, wanted.name)} {wanted.specifier}"


def test_the_recipe_requires_what_pip_would_install() -> None:
    host, run = RECIPE["requirements"]["host"], RECIPE["requirements"]["run"]
    assert run[:2] == ["python >=${{ python_min }}", "__linux"]
    assert run[2:] == sorted(map(conda_requirement, PROJECT["dependencies"]))
    assert host == ["python ${{ python_min }}.*", "pip", *map(conda_requirement, PYPROJECT["build-system"]["requires"])]
    assert PROJECT["requires-python"] == f">={RECIPE['context']['python_min']}"


def test_the_recipe_is_of_this_version_and_has_the_command() -> None:
    assert RECIPE["context"]["version"] == PROJECT["version"]
    assert RECIPE["package"] == {"name": PROJECT["name"], "version": "${{ version }}"}
    (command,) = PROJECT["scripts"].items()
    assert RECIPE["build"]["python"]["entry_points"] == [" = ".join(command)]
    assert RECIPE["about"]["summary"] == PROJECT["description"].rstrip(".")
    assert RECIPE["about"]["license"] == PROJECT["license"]
    assert [RECIPE["about"]["license_file"]] == PROJECT["license-files"]
    assert (ROOT / "packaging/conda" / RECIPE["source"]["path"]).samefile(ROOT)


def test_the_image_has_a_python_and_extras_that_there_are() -> None:
    (python,) = re.findall(r"^ARG PYTHON=(\S+)", DOCKERFILE, re.MULTILINE)
    (extras,) = re.findall(r"^ARG EXTRAS=(\S+)", DOCKERFILE, re.MULTILINE)
    assert python in SpecifierSet(PROJECT["requires-python"])
    assert f"Programming Language :: Python :: {python}" in PROJECT["classifiers"]
    assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"])
    action = yaml.safe_load((ROOT / "action.yml").read_text())["inputs"]
    assert (action["python-version"]["default"], action["extras"]["default"]) == (python, extras)


def test_the_build_gets_what_the_wheel_is_made_of() -> None:
    """Docker copies what .dockerignore lets through."""
    ignored, *rules = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if not line.startswith("#")]
    assert ignored == "*"
    wheel = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]
    needed = [
        "pyproject.toml",
        PROJECT["readme"],
        *PROJECT["license-files"],
        *wheel["packages"],
        *wheel["force-include"],
    ]
    assert sorted(rule.removeprefix("!") for rule in rules if rule.startswith("!")) == sorted(needed)


@pytest.mark.parametrize("line", ["docker run ", "docker build "])
def test_the_page_shows_the_commands_of_the_dockerfile(line: str) -> None:
    (shown,) = re.findall(rf"^# ({line}.*)", DOCKERFILE, re.MULTILINE)
    assert shown in (DOCS / "install.md").read_text()


def test_all_of_it_is_in_the_source_distribution() -> None:
    included = PYPROJECT["tool"]["hatch"]["build"]["targets"]["sdist"]["include"]
    for path in ("Dockerfile", ".dockerignore", "action.yml", "packaging/conda/recipe.yaml", "tests/packaging"):
        assert (ROOT / path).exists()
        assert any(fnmatch(f"/{path}", f"{pattern}*") for pattern in included), path
