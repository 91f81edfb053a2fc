"""Distributions made on the spot: a module beside the metadata that pip would have written for it."""

from __future__ import annotations

import shutil
from pathlib import Path

from project import THIRD_PARTY


def install_source(site: Path, name: str, version: str, source: str) -> None:
    """Put a one-module plugin distribution into the folder `site`."""
    module = name.replace("-", "_")
    (site / f"{module}.py").write_text(source)
    register(site, name, version, module)


def install_posterize(site: Path) -> None:
    """Put the example distribution with a codec into the folder `site`."""
    _install_package(site, "codecbench-posterize", "0.3.0")


def install_edges(site: Path) -> None:
    """Put the example distribution with an evaluator into the folder `site`."""
    _install_package(site, "codecbench-edges", "0.1.0")


def install_zoo(site: Path) -> None:
    """Put the distribution whose plugins misbehave into the folder `site`."""
    _install_package(site, "codecbench-zoo", "1.0")


def _install_package(site: Path, name: str, version: str) -> None:
    package = THIRD_PARTY / name.removeprefix("codecbench-") / name.replace("-", "_")
    shutil.copytree(package, site / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    register(site, name, version, package.name)


def register(site: Path, name: str, version: str, module: str) -> None:
    """Write the metadata that makes `module` an entry point of codecbench."""
    info = site / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    (info / "entry_points.txt").write_text(f"[codecbench]\n{module} = {module}\n")
