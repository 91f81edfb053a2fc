"""`codecbench plan`."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import click

from codecbench.cli.saying import say
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
    """Show what `codecbench run MATRIX` would do: coding jobs, cells, what is done already and what is unsupported."""

    made, folder, growth = running.planned(matrix_file.read_matrix(matrix), out)
    store = run_store.Store(folder)
    store.refuse_links()
    entries = store.entries() if folder.exists() else {}
    outdated = resume.outdated_cells(made, entries, store)
    kept = resume.kept_cells(made, {id_: entry for id_, entry in entries.items() if id_ not in outdated})
    done = {id_ for id_, status in kept.items() if status == "ok"}
    unsupported = [cell for cell in made.cells if cell.unsupported is not None]
    missing = [cell for cell in made.cells if cell.id not in done and cell.unsupported is None]
    wanted = {cell.job_id for cell in missing if cell.job_id is not None}
    coded = {job.id for job in made.jobs if store.coded_path(job.id).exists()}
    to_code = [job for job in made.jobs if job.id in wanted and job.id not in coded]
    _say(f"{made.name}: {counted(len(made.sequences), 'sequence')}, run folder {folder}")
    _list_sequences(made)
    _say(f"coding jobs: {len(made.jobs)}: {len(coded)} coded, {len(to_code)} to do")
    _say(f"cells: {len(made.cells)}: {len(done)} done, {len(missing)} to do, {len(unsupported)} unsupported")
    for reason, count in Counter(cell.unsupported for cell in unsupported).items():
        _say(f"  unsupported ({count}): {reason}")
    for reason, count in Counter(outdated.values()).items():
        _say(f"  done before, to do again ({count}): {reason}")
    with_result = {id_: entries[id_] for id_ in done}
    for notice in code_changes.code_notices(made, with_result, store, registry.installed()):
        _say(f"  {clean_line(notice)}")
    if growth is not None:
        _say("the plan grows as its searches, repeats and awaited times need; this is its next round")
    for finding in made.searches:
        _say(f"  {clean_line(str(finding))}")
    if cells:
        _list_all(made, done, coded)
    guess = estimate.estimate(made, missing, len(to_code), {key: entry.duration_s for key, entry in entries.items()})
    basis = f"{counted(guess.measured, 'cell')} from measured durations, {guess.typical} from typical costs"
    workers = counted(made.run.workers, "worker")
    _say(f"estimated time: {_spoken(guess.seconds)} with {workers} ({basis})")


def _say(line: str) -> None:
    say(line, indent=4)


def _list_sequences(made: Plan) -> None:
    for entry in made.sequences:
        camera = ["camera"] if entry.has_camera else []
        truth = ["ground truth"] if entry.has_ground_truth else []
        layout = "gray" if entry.channels == 1 else "colour"
        _say(f"  {entry.name}: {', '.join([counted(entry.frames, 'frame'), layout, *camera, *truth])}")
        for note in entry.notes:
            _say(f"    {note}")


def _list_all(made: Plan, done: set[str], coded: set[str]) -> None:
    for job in made.jobs:
        state = "coded" if job.id in coded else "to do"
        _say(f"  code  {job.id[:12]}  {state:5}  {job.sequence.name} | {job.codec.name} {job.codec.label}".rstrip())
    for cell in made.cells:
        state = "done" if cell.id in done else "unsupported" if cell.unsupported else "to do"
        what = f"{cell.sequence.name} | {cell.codec.name} {cell.codec.label}".rstrip()
        evaluator = f"{cell.evaluator.name} {cell.evaluator.label}".rstrip()
        _say(f"  cell  {cell.id[:12]}  {state:11}  {what} | {evaluator} #{cell.repeat}")


def _spoken(seconds: float) -> str:
    if seconds < 90:
        return f"about {seconds:.0f} s"
    return f"about {seconds / 60:.0f} min" if seconds < 5400 else f"about {seconds / 3600:.1f} h"
