"""`codecbench bundle` and `codecbench open`."""

from __future__ import annotations

from pathlib import Path

import click

from codecbench.cli import rank as ranking
from codecbench.cli import show
from codecbench.core.analysis import collect
from codecbench.core.engine.bundling import packing, unpacking
from codecbench.core.engine.plugins import registry
from codecbench.core.engine.text import counted
from codecbench.core.report import page as report_page
from codecbench.core.report import tables


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--bitstreams", is_flag=True, help="Also what the codecs wrote; that may be large.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The file; default RUN.bundle.zip.")
def bundle(run: Path, bitstreams: bool, out: Path | None) -> None:
    """Put the RUN folder into one file that can be kept, cited, and opened by others.

    It holds the matrix, the plan, every record with its trajectories, and the environments, each file with its
    SHA-256. The same run gives the same bytes.
    """

    made = packing.write_bundle(run, out, bitstreams=bitstreams)
    manifest = made.manifest
    statuses = ", ".join(f"{count} {status}" for status, count in manifest.statuses.items())
    click.echo(f"{made.path}: {counted(manifest.cells, 'cell')} ({statuses}), {counted(len(manifest.files), 'file')}")
    click.echo(f"{made.size_bytes:,} bytes")
    click.echo(f"SHA-256 {made.sha256}")


@click.command("open")
@click.argument("bundle", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="The folder; default: beside BUNDLE.")
@click.option(
    "--sequences-from",
    metavar="FOLDER|same",
    help="Show frames, of a bundle with bitstreams: from sequences in FOLDER, or where its plan names them.",
)
def open_bundle(bundle: Path, out: Path | None, sequences_from: str | None) -> None:
    """Unpack a BUNDLE into a run folder and report on it.

    A bundle is data: names, sizes and SHA-256 of its files are checked, no code of it is run, and nothing that its plan
    names is opened. What results mean is read from the plan where a plugin is not installed.
    """

    folder = out or unpacking.folder_beside(bundle)
    manifest = unpacking.unpack_bundle(bundle, folder)
    run = collect.open_nonempty_run(folder)
    ranking.show_notes(tables.notes(run), True)
    show.show_reasons(run)
    click.echo(f"bundled by codecbench {manifest.codecbench}; its {len(manifest.files)} files are as they were bundled")
    if absent := collect.absent_plugins(run.plan, registry.installed()):
        click.echo(f"not installed, and shown by what the plan keeps of them: {', '.join(absent)}")
    path = folder / "report" / "report.html"
    report_page.write_report(run, path, sequences_from=sequences_from)
    click.echo(f"run folder: {folder}")
    click.echo(f"report: {path}\n")
    ranking.show_answer(run)
