"""`codecbench plan` and `codecbench status`."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from codecbench.cli.messages import say
from codecbench.core.engine.planning import estimate
from codecbench.core.engine.planning import matrix as matrix_file
from codecbench.core.engine.plugins import registry
from codecbench.core.engine.running import code_changes, resume
from codecbench.core.engine.storage import store as run_store
from codecbench.core.engine.text import clean_line, counted
from codecbench.core.rounds import running

if TYPE_CHECKING:
    from codecbench.core.engine.planning.model import Plan


@click.command()
@click.argument("matrix", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="The run folder; default runs/NAME.")
@click.option("--cells", is_flag=True, help="List every coding job and cell.")
def plan(matrix: Path, out: Path | None, cells: bool) -> None:
    """Show what `codecbench run MATRIX` would do: coding jobs, cells, and which of them are done or unsupported."""
    next_plan, folder, growth = running.plan_matrix(matrix_file.read_matrix(matrix), out)
    store = run_store.Store(folder)
    store.refuse_links()
    entries = store.entries() if folder.exists() else {}
    outdated = resume.outdated_cells(next_plan, entries, store)
    statuses = resume.kept_cells(next_plan, {id_: entry for id_, entry in entries.items() if id_ not in outdated})
    done = {id_ for id_, status in statuses.items() if status == "ok"}
    unsupported = [cell for cell in next_plan.cells if cell.unsupported is not None]
    missing = [cell for cell in next_plan.cells if cell.id not in done and cell.unsupported is None]
    job_ids = {cell.job_id for cell in missing if cell.job_id is not None}
    coded = {job.id for job in next_plan.jobs if store.coded_path(job.id).exists()}
    to_code = [job for job in next_plan.jobs if job.id in job_ids and job.id not in coded]
    _say(f"{next_plan.name}: {counted(len(next_plan.sequences), 'sequence')}, run folder {folder}")
    _list_sequences(next_plan)
    _say(f"coding jobs: {len(next_plan.jobs)}: {len(coded)} coded, {len(to_code)} to do")
    _say(f"cells: {len(next_plan.cells)}: {len(done)} done, {len(missing)} to do, {len(unsupported)} unsupported")
    for reason, count in Counter(cell.unsupported for cell in unsupported).items():
        _say(f"  unsupported ({count}): {reason}")
    for reason, count in Counter(outdated.values()).items():
        _say(f"  outdated, to do again ({count}): {reason}")
    with_result = {id_: entries[id_] for id_ in done}
    for notice in code_changes.code_notices(next_plan, with_result, store, registry.installed()):
        _say(f"  {clean_line(notice)}")
    if growth is not None:
        _say("searches, repeats and measured times can extend the plan; this is its next round")
    for finding in next_plan.searches:
        _say(f"  {clean_line(str(finding))}")
    if cells:
        _list_all(next_plan, done, coded)
    duration = estimate.estimate(
        next_plan, missing, len(to_code), {key: entry.duration_s for key, entry in entries.items()}
    )
    basis = f"{counted(duration.measured, 'cell')} from measured durations, {duration.typical} from typical costs"
    workers = counted(next_plan.run.workers, "worker")
    _say(f"estimated time: {_format_duration(duration.seconds)} with {workers} ({basis})")


def _say(line: str) -> None:
    say(line, indent=4)


def _list_sequences(plan: Plan) -> None:
    for entry in plan.sequences:
        depth = ["depth"] if entry.has_depth else []
        camera = ["camera"] if entry.has_camera else []
        truth = ["ground truth"] if entry.has_ground_truth else []
        _say(
            f"  {entry.name}: {', '.join([counted(entry.frames, 'frame'), str(entry.layout), *depth, *camera, *truth])}"
        )
        for note in entry.notes:
            _say(f"    {note}")


def _list_all(plan: Plan, done: set[str], coded: set[str]) -> None:
    for job in plan.jobs:
        state = "coded" if job.id in coded else "to do"
        _say(f"  code  {job.id[:12]}  {state:5}  {job.sequence.name} | {job.codec.name} {job.codec.label}".rstrip())
    for cell in plan.cells:
        state = "done" if cell.id in done else "unsupported" if cell.unsupported else "to do"
        subject = f"{cell.sequence.name} | {cell.codec.name} {cell.codec.label}".rstrip()
        evaluator = f"{cell.evaluator.name} {cell.evaluator.label}".rstrip()
        _say(f"  cell  {cell.id[:12]}  {state:11}  {subject} | {evaluator} #{cell.repeat}")


def _format_duration(seconds: float) -> str:
    if seconds < 90:
        return f"about {seconds:.0f} s"
    return f"about {seconds / 60:.0f} min" if seconds < 5400 else f"about {seconds / 3600:.1f} h"


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print JSON for programs to read.")
@click.option("--failed", is_flag=True, help="List the cells that failed, with their reasons.")
def status(run: Path, as_json: bool, failed: bool) -> None:
    """Show the progress of the run in the RUN folder, also while it is running."""
    store = run_store.Store(run)
    run_plan = store.read_plan()
    entries = store.entries()
    cells = [(cell, entries.get(cell.id)) for cell in run_plan.cells]
    counts = Counter("to do" if entry is None else entry.status for _, entry in cells)
    in_use = store.in_use()
    if as_json:
        click.echo(json.dumps({"name": run_plan.name, "running": in_use, "cells": len(cells), "counts": counts}))
        return
    state = "running" if in_use else "not running"
    tally = ", ".join(f"{count} {word}" for word, count in counts.most_common())
    say(f"{run_plan.name}: {state}; {counted(len(cells), 'cell')}: {tally}", indent=2)
    if failed:
        for cell, entry in cells:
            if entry is not None and entry.status not in ("ok", "unsupported"):
                codec = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
                subject = f"{cell.sequence.name} | {codec} | {cell.evaluator.name} #{cell.repeat}"
                say(f"  {entry.status}: {subject}: {entry.reason}", indent=4)
                click.echo(f"    {store.record_folder(cell.id)}")
