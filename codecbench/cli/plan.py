"""`codecbench plan`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from codecbench.core.engine.planning.model import Plan


@click.command()
@click.argument("matrix", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="The run folder; default runs/NAME.")
@click.option("--cells", is_flag=True, help="List every coding job and cell.")
def plan(matrix: Path, out: Path | None, cells: bool) -> None:
    """Show what `codecbench run MATRIX` would do: coding jobs, cells, what is done already and what is unsupported."""
    from codecbench.core.engine.foreign_text import clean_line
    from codecbench.core.engine.planning.estimate import estimate
    from codecbench.core.engine.planning.matrix import read_matrix
    from codecbench.core.engine.registry import installed
    from codecbench.core.engine.running.code_changes import code_notices
    from codecbench.core.engine.running.resume import kept_cells, outdated_cells
    from codecbench.core.engine.storage.store import Store
    from codecbench.core.rounds.running import planned

    made, folder, growth = planned(read_matrix(matrix), out)
    store = Store(folder)
    store.refuse_links()
    entries = store.entries() if folder.exists() else {}
    outdated = outdated_cells(made, entries, store, installed())
    kept = kept_cells(made, {id_: entry for id_, entry in entries.items() if id_ not in outdated})
    done = {id_ for id_, status in kept.items() if status == "ok"}
    unsupported = [cell for cell in made.cells if cell.unsupported is not None]
    missing = [cell for cell in made.cells if cell.id not in done and cell.unsupported is None]
    wanted = {cell.job_id for cell in missing if cell.job_id is not None}
    coded = {job.id for job in made.jobs if store.coded_path(job.id).exists()}
    to_code = [job for job in made.jobs if job.id in wanted and job.id not in coded]
    click.echo(f"{made.name}: {len(made.sequences)} sequences, run folder {folder}")
    _list_sequences(made)
    click.echo(f"coding jobs: {len(made.jobs)}, of which {len(coded)} are coded and {len(to_code)} are to do")
    click.echo(f"cells: {len(made.cells)}: {len(done)} done, {len(missing)} to do, {len(unsupported)} unsupported")
    for reason, count in Counter(cell.unsupported for cell in unsupported).items():
        click.echo(f"  unsupported ({count}): {reason}")
    for reason, count in Counter(outdated.values()).items():
        click.echo(f"  done before, to do again ({count}): {reason}")
    with_result = {id_: entries[id_] for id_ in done}
    for notice in code_notices(made, with_result, store, installed()):
        click.echo(f"  {clean_line(notice)}")
    if growth is not None:
        click.echo("the plan grows as its searches, repeats and awaited times need; this is its next round")
    for finding in made.searches:
        click.echo(f"  {clean_line(str(finding))}")
    if cells:
        _list_all(made, done, coded)
    guess = estimate(made, missing, len(to_code), {key: entry.duration_s for key, entry in entries.items()})
    basis = f"{guess.measured} cells from measured durations, {guess.typical} from typical costs"
    click.echo(f"estimated time: {_spoken(guess.seconds)} with {made.run.workers} workers ({basis})")


def _list_sequences(made: Plan) -> None:
    for entry in made.sequences:
        camera = ["camera"] if entry.has_camera else []
        truth = ["ground truth"] if entry.has_ground_truth else []
        layout = "gray" if entry.channels == 1 else "colour"
        click.echo(f"  {entry.name}: {', '.join([f'{entry.frames} frames', layout, *camera, *truth])}")
        for note in entry.notes:
            click.echo(f"    {note}")


def _list_all(made: Plan, done: set[str], coded: set[str]) -> None:
    for job in made.jobs:
        state = "coded" if job.id in coded else "to do"
        click.echo(
            f"  code  {job.id[:12]}  {state:5}  {job.sequence.name} | {job.codec.name} {job.codec.label}".rstrip()
        )
    for cell in made.cells:
        state = "done" if cell.id in done else "unsupported" if cell.unsupported else "to do"
        what = f"{cell.sequence.name} | {cell.codec.name} {cell.codec.label}".rstrip()
        click.echo(
            f"  cell  {cell.id[:12]}  {state:11}  {what} | {cell.evaluator.name} {cell.evaluator.label} #{cell.repeat}"
        )


def _spoken(seconds: float) -> str:
    if seconds < 90:
        return f"about {seconds:.0f} s"
    return f"about {seconds / 60:.0f} min" if seconds < 5400 else f"about {seconds / 3600:.1f} h"
