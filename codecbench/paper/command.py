"""`codecbench reproduce`."""

from __future__ import annotations

from pathlib import Path

import click

from codecbench.core.analysis import collect
from codecbench.paper import page as paper_page


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=Path("paper.md"), show_default=True)
def reproduce(runs: tuple[Path, ...], out: Path) -> None:
    """Write the page that puts the paper beside a run of examples/paper.yaml, table by table.

    Trajectories of further runs, such as examples/paper_loops.yaml, are added.
    """

    for path in paper_page.write_page([collect.open_nonempty_run(run) for run in runs], out):
        click.echo(str(path))
