"""`codecbench examples`, and the example matrices in the installed package or in a checkout."""

from __future__ import annotations

import difflib
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

import click

from codecbench.core.contracts.errors import MatrixError
from codecbench.core.engine.storage import atomic


@click.command()
@click.argument("name", required=False)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write the matrix to this file.")
def examples(name: str | None, out: Path | None) -> None:
    """List the example matrices that come with codecbench, or print the one called NAME."""
    if name is None:
        width = max(len(each) for each in example_names())
        for example_name in example_names():
            click.echo(f"{example_name:<{width}}  {summary(example_name)}")
        return
    text = example(name)
    if out is None:
        click.echo(text, nl=False)
        return
    if out.exists():
        raise click.UsageError(f"{out} already exists; give another --out")
    atomic.write_file(out, text.encode())
    click.echo(f"{out}; now: codecbench run {out}")


def example_names() -> list[str]:
    """Return the names of the examples, `first` first."""
    names = [file.name.removesuffix(".yaml") for file in _folder().iterdir() if file.name.endswith(".yaml")]
    return sorted(names, key=lambda name: (name != "first", name))


def example(name: str) -> str:
    """Return the text of an example. Raises MatrixError, with the nearest name, if there is none."""
    names = example_names()
    bare = name.removesuffix(".yaml")
    if bare not in names:
        matches = difflib.get_close_matches(bare, names, n=1)
        hint = f"did you mean {matches[0]!r}? " if matches else ""
        raise MatrixError(f"no example is called {name!r}; {hint}available: {', '.join(names)}")
    return (_folder() / f"{bare}.yaml").read_text(encoding="utf-8")


def summary(name: str) -> str:
    """Return the first sentence of an example's comment."""
    comment = " ".join(line.removeprefix("#").strip() for line in example(name).splitlines() if line.startswith("#"))
    return comment.partition(". ")[0].rstrip(".")


def _folder() -> Traversable:
    """Return the folder of the examples: in the package if that comes from a wheel, else beside it."""
    packaged = files("codecbench") / "examples"
    return packaged if packaged.is_dir() else Path(__file__).resolve().parents[2] / "examples"
