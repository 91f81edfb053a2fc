"""`codecbench warm-up`."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from codecbench.cli import display
from codecbench.cli.messages import ExitStatus
from codecbench.core.engine.planning import matrix as matrix_file
from codecbench.core.engine.planning import plan as planning
from codecbench.core.engine.plugins import registry
from codecbench.core.engine.running import record_kernels, work
from codecbench.core.engine.running import warm_up as kernel_warm_up

if TYPE_CHECKING:
    from codecbench.core.engine.running.warm_up import WarmUp


@click.command("warm-up")
@click.argument("matrices", nargs=-1, metavar="[MATRIX]...", type=click.Path(path_type=Path))
@click.option("--workers", type=click.IntRange(1), help="Worker processes; default: one per core.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    metavar="KERNELS",
    help="Copy the compiled kernels into this folder; runs use them if CODECBENCH_KERNELS names it.",
)
@click.option(
    "--record", "packages", multiple=True, metavar="PACKAGE", help="Write the kernels.json of PACKAGE; repeatable."
)
def warm_up(matrices: tuple[Path, ...], workers: int | None, out: Path | None, packages: tuple[str, ...]) -> None:
    """Compile the kernels that runs of each MATRIX will call, or all that installed plugins list.

    For container images, continuous integration and other machines; a run does the same when it starts. With
    --record, do the work of each MATRIX in one process and write down which kernels of each PACKAGE it called.
    """
    out = out and out.absolute()
    if packages:
        _record(matrices, packages)
    elif not matrices:
        _compile(kernel_warm_up.all_kernels(registry.installed(), out), workers)
    else:
        plans = [planning.make_sampled_plan(matrix_file.read_matrix(matrix)) for matrix in matrices]
        cells = [cell for plan in plans for cell in plan.cells if cell.unsupported is None]
        _compile(kernel_warm_up.kernels_to_compile(cells, registry.installed(), out), workers)


def _compile(wanted: WarmUp, workers: int | None) -> None:
    started = time.monotonic()
    executor = registry.installed().create("executor", "local", {})
    console = display.Screen(stderr=True)
    try:
        executor.start(max(1, min(workers or os.cpu_count() or 1, len(wanted))), work.prepare_worker)
        with console.status("") as status:
            while wanted:
                while (task := wanted.take()) is not None:
                    executor.submit(task)
                status.update(wanted.progress)
                finished = executor.next_finished(0.2)
                if finished is not None and wanted.finish(finished):
                    outcome = "compiled" if finished.status == "ok" else f"not compiled ({finished.reason})"
                    click.echo(f"{outcome}: {finished.task_id}")
    finally:
        executor.stop()
    click.echo(f"{wanted.total} kernels to compile, {wanted.failed} failed, {time.monotonic() - started:.1f} s")
    if wanted.failed:
        raise click.exceptions.Exit(ExitStatus.FOUND)


def _record(matrices: tuple[Path, ...], packages: tuple[str, ...]) -> None:
    if not matrices:
        raise click.UsageError("--record needs a MATRIX that calls the kernels")
    for path in record_kernels.record_kernels(matrices, packages):
        click.echo(path)
