"""`codecbench try` and `codecbench init`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from codecbench.cli import examples
from codecbench.cli.parameters import codec_names
from codecbench.cli.rank import everything_option
from codecbench.cli.run import run_and_report
from codecbench.core.engine.planning import matrix as matrix_file
from codecbench.core.engine.plugins import registry
from codecbench.core.engine.storage import atomic
from codecbench.core.engine.text import counted
from codecbench.trial import trial

if TYPE_CHECKING:
    from codecbench.trial.trial_matrix import TrialMatrix

_AIMS = ("tracking", "quality", "speed", "depth")


def _choices(command: Callable[..., Any]) -> Callable[..., Any]:
    """The options by which a matrix is chosen."""
    for option in reversed((
        click.option("--codec", "codecs", multiple=True, metavar="CODEC", shell_complete=codec_names,
                     help="Codec and values, such as jpeg:5..90 or h264:crf=18..40; repeatable."),
        click.option("--for", "aim", type=click.Choice(_AIMS),
                     help="What the frames are for; default: what suits the recording."),
        click.option("--minutes", type=click.FloatRange(min=0, min_open=True), show_default="5 for tracking, else 2.5",
                     help="Approximate duration; a long recording is cut to fit."),
        click.option("--fov", type=click.FloatRange(0, 180, min_open=True, max_open=True), metavar="DEGREES",
                     help="The camera's horizontal field of view, if there is no calibration."),
        click.option("--set", "set_", multiple=True, metavar="NAME=VALUE",
                     help="Parameter of the dataset, such as topic=/camera/image_raw; repeatable."),
    )):  # fmt: skip
        command = option(command)
    return command


@click.command("try")
@click.argument("path", type=click.Path(path_type=Path))
@_choices
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="The run folder; default runs/try-NAME.")
@click.option("--workers", type=click.IntRange(1), help="Worker processes; default: one per core.")
@everything_option
@click.option("--open/--no-open", "show", default=None, help="Open the report in a browser; by default on a desktop.")
def try_(
    path: Path,
    codecs: tuple[str, ...],
    aim: str | None,
    minutes: float | None,
    fov: float | None,
    set_: tuple[str, ...],
    out: Path | None,
    workers: int | None,
    everything: bool,
    show: bool | None,
) -> None:
    """Try codecs on the recording at PATH, and write a report.

    PATH is a folder of images, a video, a TUM, KITTI, EuRoC or LeRobot folder, or a ROS bag. The run folder keeps the
    chosen matrix, to edit and run again.
    """
    click.echo(f"opening {path} ...", err=True)
    made = _fit_matrix(path, codecs, aim, minutes, fov, set_)

    work = f"{counted(made.settings, 'setting')} on {counted(made.frames, 'frame')}"
    click.echo(f"{work}: about {made.minutes} min{', including compilation of kernels, once' if made.compiles else ''}")

    show = _on_desktop() if show is None else show
    matrix = matrix_file.matrix_from(made.text)
    run_and_report(matrix, out, workers=workers, show=show, minutes=made.most_minutes, everything=everything)


@click.command()
@click.option("--from", "path", type=click.Path(path_type=Path), help="Write a matrix for this recording.")
@_choices
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=Path("matrix.yaml"), show_default=True,
              help="File to write; - is standard output.")  # fmt: skip
@click.option("--force", is_flag=True, help="Overwrite an existing file.")
def init(
    path: Path | None,
    codecs: tuple[str, ...],
    aim: str | None,
    minutes: float | None,
    fov: float | None,
    set_: tuple[str, ...],
    out: Path,
    force: bool,
) -> None:
    """Write a matrix with comments, to edit: one for a recording, or a small one to start from."""
    text = (
        examples.example("first")
        if path is None
        else _fit_matrix(path, codecs, aim, minutes, fov, set_, with_notes=True).text
    )
    if str(out) == "-":
        click.echo(text, nl=False)
        return
    if out.exists() and not force:
        raise click.UsageError(f"{out} already exists; give another --out, or --force to overwrite it")
    atomic.write_file(out, text.encode())
    click.echo(f"{out}; now: codecbench run {out}")


def _fit_matrix(
    path: Path,
    codecs: tuple[str, ...],
    aim: Any,
    minutes: float | None,
    fov: float | None,
    set_: tuple[str, ...],
    *,
    with_notes: bool = False,
) -> TrialMatrix:
    """Return the matrix for the recording at `path`; print the recording and the choices as soon as they are known.

    with_notes: print the notes of its dataset too, which the run prints otherwise.
    """
    recording = trial.open_recording(path, fov, trial.parse_params(set_))
    for line in (str(recording), *(recording.notes if with_notes else ()), *recording.assumed):
        click.echo(line, err=True)
    fitted = trial.fit_matrix(registry.installed(), recording, codecs, aim, minutes)
    for line in fitted.choices:
        click.echo(line, err=True)
    return fitted


def _on_desktop() -> bool:
    return sys.stdout.isatty() and bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
