"""`codecbench verify-run`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from codecbench.cli.exit_status import ExitStatus
from codecbench.core.analysis import verification
from codecbench.core.engine.text import clean_line

if TYPE_CHECKING:
    from codecbench.core.analysis.verification import Agreement


@click.command("verify-run")
@click.argument("bundle", type=click.Path(path_type=Path))
@click.option("--cells", type=click.IntRange(1), default=5, show_default=True, help="How many cells.")
@click.option("--seed", type=int, default=0, show_default=True, help="Chooses the cells.")
@click.option(
    "--tolerance",
    type=click.FloatRange(0),
    default=1e-6,
    show_default=True,
    help="The relative difference of two values up to which they agree where libraries have other versions, or the "
    "processor has other vector instructions.",
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="A fresh run folder, to keep the cells.")
@click.option("--workers", type=click.IntRange(1), help="Worker processes; by default one a processor.")
@click.option(
    "--sequences-from",
    metavar="FOLDER|same",
    help="Where sequences are that the plan names by path: in FOLDER, or where it says.",
)
def verify_run(
    bundle: Path, cells: int, seed: int, tolerance: float, out: Path | None, workers: int | None,
    sequences_from: str | None,
) -> None:  # fmt: skip
    """Compute a sample of the cells of a BUNDLE, or of a run folder, again, and say which agree.

    Compared are all values that equal code gives again; times are not, nor what depends on the machine. Where
    libraries have the versions that they had, and the processor the vector instructions, values must be equal to the
    last bit. The exit status is 1 if a cell differs, or none could be computed.
    """

    found = verification.verify_run(
        bundle, cells=cells, seed=seed, tolerance=tolerance, out=out, workers=workers, sequences_from=sequences_from,
    )  # fmt: skip
    chosen = f"{len(found.cells)} of {found.of} cells, chosen by seed {seed}"
    click.echo(f"{found.name}: {chosen}" + (f"; {found.left_out} measured only times" if found.left_out else ""))
    for agreement in found.cells:
        click.echo(clean_line(_line(agreement)))
    counts = ", ".join(f"{count} {verdict}" for verdict, count in found.counts.items()) or "no cell to compare"
    click.echo(
        f"{counts}; tolerance {tolerance:g} of the value where versions or instructions differ, times are not compared"
    )
    if out is not None:
        click.echo(f"run folder: {out}")
    if not found.holds:
        raise click.exceptions.Exit(ExitStatus.FOUND)


def _line(agreement: Agreement) -> str:
    cell = agreement.cell
    what = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
    note = agreement.note or f"{agreement.values} values"
    return f"{agreement.verdict:17} {cell.sequence.name} | {what} | {cell.evaluator.title} #{cell.repeat}: {note}"
