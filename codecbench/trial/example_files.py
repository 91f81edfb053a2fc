"""The example matrices, as they come with the wheel or lie in a checkout."""

from __future__ import annotations

import difflib
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

from codecbench.core.contracts.errors import MatrixError


def example_names() -> list[str]:
    """What the examples are called, `first` first."""
    names = [file.name.removesuffix(".yaml") for file in _folder().iterdir() if file.name.endswith(".yaml")]
    return sorted(names, key=lambda name: (name != "first", name))


def example(name: str) -> str:
    """The text of an example. Raises MatrixError, with the nearest name, where there is none."""
    names = example_names()
    bare = name.removesuffix(".yaml")
    if bare not in names:
        near = difflib.get_close_matches(bare, names, n=1)
        meant = f"did you mean {near[0]!r}? " if near else ""
        raise MatrixError(f"no example is called {name!r}; {meant}there are {', '.join(names)}")
    return (_folder() / f"{bare}.yaml").read_text(encoding="utf-8")


def summary(name: str) -> str:
    """The first sentence of an example's comment."""
    comment = " ".join(line.removeprefix("#").strip() for line in example(name).splitlines() if line.startswith("#"))
    return comment.partition(". ")[0].rstrip(".")


def _folder() -> Traversable:
    """In the package where it was installed from a wheel, else beside it."""
    packaged = files("codecbench") / "examples"
    return packaged if packaged.is_dir() else Path(__file__).resolve().parents[2] / "examples"
