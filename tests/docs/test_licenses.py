"""The page on licenses names every copyleft package that an installation or an extra brings with it."""

from __future__ import annotations

import ast
import re
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from project import DOCS, ROOT

COPYLEFT = re.compile(r"\b[AL]?GPL|\bGNU\b|\bMPL\b|Mozilla|\bEPL\b|\bCDDL\b")
PAGE = (DOCS / "licenses.md").read_text()
EXTRAS = sorted(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])


def license_of(package: Distribution) -> str:
    """What a distribution says of its license, in its several fields; long texts by their first line."""
    metadata = package.metadata
    stated = [metadata.get("License-Expression") or "", (metadata.get("License") or "").partition("\n")[0]]
    return " ".join(stated + [line for line in metadata.get_all("Classifier") or [] if line.startswith("License")])


def installed_with(name: str, extras: frozenset[str], seen: dict[tuple[str, frozenset[str]], Distribution]) -> None:
    """Collect the distribution and all that it requires, as far as they are installed here."""
    key = (name.lower(), extras)
    if key in seen:
        return
    try:
        seen[key] = distribution(name)
    except PackageNotFoundError:
        return
    for text in seen[key].requires or []:
        wanted = Requirement(text)
        if wanted.marker is None or any(wanted.marker.evaluate({"extra": extra}) for extra in extras | {""}):
            installed_with(wanted.name, frozenset(wanted.extras), seen)


@pytest.mark.parametrize("extra", ["", *EXTRAS])
def test_every_copyleft_package_is_named(extra: str) -> None:
    seen: dict[tuple[str, frozenset[str]], Distribution] = {}
    installed_with("codecbench", frozenset([extra]), seen)
    assert len(seen) > 20
    copyleft = {name for (name, _), package in seen.items() if COPYLEFT.search(license_of(package))}
    assert "evo" in copyleft
    assert {name for name in copyleft if f"| {name} |" not in PAGE} == set()


def test_what_wheels_carry_is_named_where_their_metadata_is_silent() -> None:
    """PyAV calls itself BSD; the libraries in its wheels are GPL builds."""
    assert "av (PyAV)" in PAGE


def test_gpl_packages_are_imported_where_the_page_says() -> None:
    importing: dict[str, set[str]] = {"av": set(), "evo": set(), "pyorbslam3": set()}
    for path in (ROOT / "codecbench").rglob("*.py"):
        text = path.read_text()
        if not any(name in text for name in importing):
            continue  # parsing takes time
        for node in ast.walk(ast.parse(text)):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                if (root := name.partition(".")[0]) in importing:
                    importing[root].add(str(Path(path).relative_to(ROOT)))
    assert importing == {
        "av": {"codecbench/plugins/codecs/video/library.py"},
        "evo": {"codecbench/plugins/evaluators/trajectory/alignment.py"},
        "pyorbslam3": {"codecbench/plugins/slam_backends/orbslam3_child.py"},
    }
