"""`codecbench bundle` and `codecbench open`."""

from __future__ import annotations

from pathlib import Path

import click

from codecbench.core.engine.text import counted


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--bitstreams", is_flag=True, help="Also what the codecs wrote; that may be large.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The file; default RUN.bundle.zip.")
def bundle(run: Path, bitstreams: bool, out: Path | None) -> None:
    """Put the RUN folder into one file that can be kept, cited, and opened by others.

    It holds the matrix, the plan, every record with its trajectories, and the environments, each file with its
    SHA-256. The same run gives the same bytes.
    """
    from codecbench.core.engine.bundling.packing import write_bundle

    made = write_bundle(run, out, bitstreams=bitstreams)
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
    from codecbench.cli.rank import show_answer, show_notes
    from codecbench.cli.show import show_reasons
    from codecbench.core.analysis.collect import absent_plugins, open_nonempty_run
    from codecbench.core.engine.bundling.packing import folder_beside, unpack_bundle
    from codecbench.core.engine.plugins.registry import installed
    from codecbench.core.report.page import write_report
    from codecbench.core.report.tables import notes

    folder = out or folder_beside(bundle)
    manifest = unpack_bundle(bundle, folder)
    run = open_nonempty_run(folder)
    show_notes(notes(run), True)
    show_reasons(run)
    click.echo(f"bundled by codecbench {manifest.codecbench}; its {len(manifest.files)} files are as they were bundled")
    if absent := absent_plugins(run.plan, installed()):
        click.echo(f"not installed, and shown by what the plan keeps of them: {', '.join(absent)}")
    path = folder / "report" / "report.html"
    write_report(run, path, sequences_from=sequences_from)
    click.echo(f"run folder: {folder}")
    click.echo(f"report: {path}\n")
    show_answer(run)
