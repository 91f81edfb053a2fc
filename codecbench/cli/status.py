"""`codecbench status`."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import click

from codecbench.cli.saying import say
from codecbench.core.engine.storage import store as run_store
from codecbench.core.engine.text import counted


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs to read.")
@click.option("--failed", is_flag=True, help="List the cells that failed, with their reasons.")
def status(run: Path, as_json: bool, failed: bool) -> None:
    """Show how far the run in the RUN folder has got, also while it is running."""

    store = run_store.Store(run)
    plan = store.read_plan()
    entries = store.entries()
    cells = [(cell, entries.get(cell.id)) for cell in plan.cells]
    counts = Counter("to do" if entry is None else entry.status for _, entry in cells)
    running = store.in_use()
    if as_json:
        click.echo(json.dumps({"name": plan.name, "running": running, "cells": len(cells), "counts": counts}))
        return
    state = "running" if running else "not running"
    tally = ", ".join(f"{count} {word}" for word, count in counts.most_common())
    say(f"{plan.name}: {state}; {counted(len(cells), 'cell')}: {tally}", indent=2)
    if failed:
        for cell, entry in cells:
            if entry is not None and entry.status not in ("ok", "unsupported"):
                where = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
                what = f"{cell.sequence.name} | {where} | {cell.evaluator.name} #{cell.repeat}"
                say(f"  {entry.status}: {what}: {entry.reason}", indent=4)
                click.echo(f"    {store.record_folder(cell.id)}")
