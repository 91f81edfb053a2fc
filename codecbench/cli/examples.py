"""`codecbench examples`."""

from __future__ import annotations

from pathlib import Path

import click

from codecbench.core.engine.storage import atomic
from codecbench.trial import example_files


@click.command()
@click.argument("name", required=False)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="Write it to this file.")
def examples(name: str | None, out: Path | None) -> None:
    """List the example matrices that come with codecbench, or print the one called NAME."""

    if name is None:
        width = max(len(known) for known in example_files.example_names())
        for known in example_files.example_names():
            click.echo(f"{known:<{width}}  {example_files.summary(known)}")
        return
    text = example_files.example(name)
    if out is None:
        click.echo(text, nl=False)
        return
    if out.exists():
        raise click.UsageError(f"{out} is there already; give another --out")
    atomic.write_file(out, text.encode())
    click.echo(f"{out}; now: codecbench run {out}")
