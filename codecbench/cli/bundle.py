"""`codecbench bundle`, `codecbench open` and `codecbench verify-run`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from codecbench.cli import rank as ranking
from codecbench.cli import show
from codecbench.cli.messages import ExitStatus
from codecbench.core.analysis import collect, verification
from codecbench.core.engine.bundling import packing
from codecbench.core.engine.plugins import registry
from codecbench.core.engine.text import clean_line, counted
from codecbench.core.report import page as report_page
from codecbench.core.report import tables

if TYPE_CHECKING:
    from codecbench.core.analysis.verification import Agreement


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--bitstreams", is_flag=True, help="Include the bitstreams, which can be large.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="File to write; default RUN.bundle.zip.")
def bundle(run: Path, bitstreams: bool, out: Path | None) -> None:
    """Pack the RUN folder into one file to archive, cite and share.

    The bundle contains the matrix, the plan, every record with its trajectories, and the environments, each file with
    its SHA-256. The same run gives the same bytes.
    """
    packed = packing.write_bundle(run, out, bitstreams=bitstreams)
    manifest = packed.manifest
    statuses = ", ".join(f"{count} {status}" for status, count in manifest.statuses.items())
    click.echo(f"{packed.path}: {counted(manifest.cells, 'cell')} ({statuses}), {counted(len(manifest.files), 'file')}")
    click.echo(f"{packed.size_bytes:,} bytes")
    click.echo(f"SHA-256 {packed.sha256}")


@click.command("open")
@click.argument("bundle", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Run folder; default: next to BUNDLE.")
@click.option(
    "--sequences-from",
    metavar="FOLDER|same",
    help="Show frames of a bundle with bitstreams, from sequences in FOLDER; `same`: from the paths in its plan.",
)
def open_bundle(bundle: Path, out: Path | None, sequences_from: str | None) -> None:
    """Unpack a BUNDLE into a run folder and report on it.

    A bundle is data: codecbench checks names, sizes and SHA-256 of its files, runs no code from it, and opens no path
    that its plan names. If a plugin is not installed, the plan describes its results.
    """
    folder = out or packing.folder_beside(bundle)
    manifest = packing.unpack_bundle(bundle, folder)
    run = collect.open_nonempty_run(folder)
    ranking.show_notes(tables.notes(run), True)
    show.show_reasons(run)
    click.echo(f"bundled by codecbench {manifest.codecbench}; its {len(manifest.files)} files are unchanged")
    if absent := collect.absent_plugins(run.plan, registry.installed()):
        click.echo(f"not installed, results shown as the plan describes them: {', '.join(absent)}")
    path = folder / "report" / "report.html"
    report_page.write_report(run, path, sequences_from=sequences_from)
    click.echo(f"run folder: {folder}")
    click.echo(f"report: {path}\n")
    ranking.show_answer(run)


@click.command("verify-run")
@click.argument("bundle", type=click.Path(path_type=Path))
@click.option("--cells", type=click.IntRange(1), default=5, show_default=True, help="Number of cells.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the random choice of cells.")
@click.option(
    "--tolerance",
    type=click.FloatRange(0),
    default=1e-6,
    show_default=True,
    help="Relative difference up to which values agree if library versions or vector instructions differ.",
)
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="New run folder that keeps the cells.")
@click.option("--workers", type=click.IntRange(1), help="Worker processes; default: one per processor.")
@click.option(
    "--sequences-from",
    metavar="FOLDER|same",
    help="Open sequences that the plan names by path from FOLDER; `same`: from the paths in the plan.",
)
def verify_run(
    bundle: Path, cells: int, seed: int, tolerance: float, out: Path | None, workers: int | None,
    sequences_from: str | None,
) -> None:  # fmt: skip
    """Recompute a sample of the cells of a BUNDLE or a run folder, and compare the values.

    Times and values that depend on the machine are not compared. If library versions and vector instructions are the
    same, all other values must be equal to the last bit. The exit status is 1 if a cell differs or none could be
    computed.
    """
    check = verification.verify_run(
        bundle, cells=cells, seed=seed, tolerance=tolerance, out=out, workers=workers, sequences_from=sequences_from,
    )  # fmt: skip
    chosen = f"{len(check.cells)} of {check.of} cells, chosen by seed {seed}"
    click.echo(f"{check.name}: {chosen}" + (f"; {check.left_out} measured only times" if check.left_out else ""))
    for agreement in check.cells:
        click.echo(clean_line(_line(agreement)))
    counts = ", ".join(f"{count} {verdict}" for verdict, count in check.counts.items()) or "no cell to compare"
    click.echo(f"{counts}; relative tolerance {tolerance:g} if versions or instructions differ, times not compared")
    if out is not None:
        click.echo(f"run folder: {out}")
    if not check.holds:
        raise click.exceptions.Exit(ExitStatus.FOUND)


def _line(agreement: Agreement) -> str:
    cell = agreement.cell
    what = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
    note = agreement.note or f"{agreement.values} values"
    return f"{agreement.verdict:17} {cell.sequence.name} | {what} | {cell.evaluator.title} #{cell.repeat}: {note}"
