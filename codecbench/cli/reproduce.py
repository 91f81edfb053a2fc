"""`codecbench reproduce`."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), default=Path("docs/reproduction.md"), show_default=True
)
def reproduce(run: Path, out: Path) -> None:
    """Write the page that puts the paper beside the RUN folder of examples/paper.yaml, table by table."""
    from codecbench.core.results.collect import open_run
    from codecbench.core.results.reproduction.page import write_page

    for path in write_page(open_run(run), out):
        click.echo(str(path))
