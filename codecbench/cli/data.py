"""`codecbench data`: datasets that can be fetched."""

from __future__ import annotations

import click
from rich.progress import DownloadColumn, Progress, TaskID, TransferSpeedColumn

from codecbench.cli import display
from codecbench.cli.messages import say
from codecbench.plugins.datasets import catalog


@click.group()
def data() -> None:
    """List, fetch and find datasets. CODECBENCH_CACHE sets the folder that stores them."""


@data.command("list")
def list_data() -> None:
    """List the datasets of the catalog, with license and citation."""
    for entry in catalog.list_datasets():
        state = "there" if entry.is_there else "by hand" if entry.manual else _size(entry.size_bytes)
        say(f"{entry.name}  [{state}]  sequence: use: {entry.kind}", indent=4, bold=True)
        say(f"    {entry.licence}; {entry.homepage}", indent=4)
        say(f"    {entry.citation}", indent=4)


@data.command()
@click.argument("name")
def fetch(name: str) -> None:
    """Fetch the dataset NAME, resuming an interrupted download, and print its folder."""
    entry = catalog.find(name)
    click.echo(f"{entry.name}: {entry.licence}\n{entry.citation}", err=True)
    columns = (*Progress.get_default_columns(), DownloadColumn(), TransferSpeedColumn())
    with Progress(*columns, console=display.Screen(stderr=True), transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def show(file: str, arrived: int, total: int | None) -> None:
            task = tasks.get(file)
            if task is None:
                task = tasks[file] = bar.add_task(file, total=total)
            bar.update(task, completed=arrived, total=total)

        folder = catalog.fetch(name, show)
    click.echo(str(folder))


@data.command()
@click.argument("name")
def path(name: str) -> None:
    """Print the folder of the dataset NAME, if it has been fetched."""
    click.echo(str(catalog.path(name)))


def _size(size_bytes: int | None) -> str:
    return "size unknown" if size_bytes is None else f"{size_bytes / 1e6:,.0f} MB"
