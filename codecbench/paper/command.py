"""`codecbench reproduce`."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("runs", metavar="RUN...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=Path("paper.md"), show_default=True)
def reproduce(runs: tuple[Path, ...], out: Path) -> None:
    """Write the page that puts the paper beside a run of examples/paper.yaml, table by table.

    Trajectories of further runs, such as examples/paper_loops.yaml, are added.
    """
    from codecbench.core.analysis.collect import open_nonempty_run
    from codecbench.paper.page import write_page

    for path in write_page([open_nonempty_run(run) for run in runs], out):
        click.echo(str(path))
