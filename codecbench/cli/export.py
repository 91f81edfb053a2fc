"""`codecbench export`."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import click

from codecbench.cli.parameters import codec_names
from codecbench.core.conformance import settings
from codecbench.core.contracts.errors import SlamError
from codecbench.core.engine.plugins import registry
from codecbench.core.engine.storage import atomic, bitstream_file
from codecbench.core.engine.storage import store as run_store
from codecbench.core.engine.text import counted
from codecbench.exporting import cells, coded_run, tum_files
from codecbench.plugins.codecs.video import codecs, muxing

if TYPE_CHECKING:
    from codecbench.core.analysis.table import CellResult
    from codecbench.core.engine.planning.model import CodingJob
    from codecbench.core.engine.storage.bitstream_file import BitstreamFile

_SUFFIXES: Final = {
    b"\xff\xd8\xff": ".jpg",
    b"\x89PNG": ".png",
    b"\x00\x00\x00\x0cjP": ".jp2",
    b"\xff\x4f\xff\x51": ".j2k",
}
"""Suffixes of image files by their first bytes; any other bitstream gets `.bin`."""

_VIEWERS: Final = {
    ".mcap": ("codecbench.exporting.mcap_file", "bag"),
    ".rrd": ("codecbench.exporting.rrd_file", "rerun"),
}
"""By the ending of a file, the module that writes it and the extra that the module needs."""


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--codec", required=True, shell_complete=codec_names, help="Codec whose bitstreams to write.")
@click.option("--setting", default="", metavar="'KEY=VALUE ...'", help="Setting to write, if the run has several.")
@click.option("--sequence", help="Sequence to write, if the run has several.")
@click.option("--frame-rate", "frame_rate_hz", type=click.FloatRange(min=0, min_open=True), metavar="HZ",
              help="Frame rate of the video; default: that of the sequence.")  # fmt: skip
@click.option("--evaluator", metavar="NAME", help="Evaluator of the trajectory, as in tables; default: the first.")
@click.option("--repeat", type=click.IntRange(min=0), default=0, show_default=True, help="Repeat of the trajectory.")
@click.option("--coded", is_flag=True, help="Write bitstreams instead of decoded frames into an .mcap file.")
@click.option("--sequences-from", metavar="FOLDER|same",
              help="Read frames of a run from elsewhere in FOLDER; `same`: in the paths of its plan.")  # fmt: skip
@click.option("--out", required=True, type=click.Path(path_type=Path),
              help="A video (.mp4 ...) for a video codec, a new folder for others, .tum, .mcap, .rrd.")  # fmt: skip
def export(
    run: Path,
    codec: str,
    setting: str,
    sequence: str | None,
    frame_rate_hz: float | None,
    evaluator: str | None,
    repeat: int,
    coded: bool,
    sequences_from: str | None,
    out: Path,
) -> None:
    """Write a codec's bitstreams or results in RUN to files that other programs read.

    Packets of a video codec go unchanged into one file. Bitstreams of an image codec go into a new folder, one file
    each: JPEG, JPEG 2000 and PNG with their suffix, others as .bin.

    A .tum file is the trajectory that SLAM estimated, for evo; the ground truth is written beside it.

    An .mcap file, for Foxglove, has the decoded frames, their values and sizes, the trajectory and the ground truth.
    An .rrd file, for Rerun, also has the raw frames and the keypoints of both.
    """
    store = run_store.Store(run)
    plan = store.read_plan()
    job = _job(plan.jobs, codec, setting, sequence)
    if out.suffix == ".tum":
        result = cells.slam_result(cells.results_of(store, plan, job), evaluator, repeat)
        for line in tum_files.write_tum(result, out):
            click.echo(line)
        return
    if out.suffix in _VIEWERS:
        _write_for_viewer(store, job, cells.results_of(store, plan, job), evaluator, repeat, sequences_from, coded, out)
        return
    bitstreams = bitstream_file.BitstreamFile(store.coded_path(job.id), job.id)
    if bitstreams.is_stream:
        _write_video(bitstreams, job, frame_rate_hz or job.sequence.frame_rate_hz, out)
    else:
        _write_pictures(bitstreams, job, out)


def _job(jobs: Sequence[CodingJob], codec: str, setting: str, sequence: str | None) -> CodingJob:
    """Return the coding job that the options select. Raises UsageError if none or several match."""
    wanted = settings.setting_from_text(setting)
    matches = [
        job for job in jobs
        if job.codec.name == codec and sequence in (None, job.sequence.name)
        and all(name in job.codec.params and job.codec.params[name] == value for name, value in wanted.items())
    ]  # fmt: skip
    if len(matches) == 1:
        return matches[0]
    names = "; ".join(f"{job.codec.name} {job.codec.label} on {job.sequence.name}" for job in matches or jobs)
    if matches:
        raise click.UsageError(f"several match; select one with --setting and --sequence: {names}")
    raise click.UsageError(f"the run has no {codec} {setting} on {sequence or 'any sequence'}; it has: {names}")


def _write_for_viewer(
    store: run_store.Store,
    job: CodingJob,
    results: tuple[CellResult, ...],
    evaluator: str | None,
    repeat: int,
    sequences_from: str | None,
    coded: bool,
    out: Path,
) -> None:
    name, extra = _VIEWERS[out.suffix]
    try:
        module = importlib.import_module(name)
    except ImportError as error:
        message = f"--out {out}: {error.name} is not installed; run: pip install 'codecbench[{extra}]'"
        raise click.UsageError(message) from error
    slam = None
    try:
        slam = cells.slam_result(results, evaluator, repeat)
    except SlamError as error:
        if evaluator is not None:
            raise
        click.echo(f"no estimated path: {error}")
    with coded_run.open_coded_run(store, job, results, slam, sequences_from) as run:
        click.echo(module.write(run, out, coded))


def _write_pictures(bitstreams: BitstreamFile, job: CodingJob, out: Path) -> None:
    if out.suffix:
        raise click.UsageError(f"--out {out}: {job.codec.name} is not a video codec; give a new folder for its files")
    if out.exists():
        raise click.UsageError(f"--out {out} already exists; give a new folder")
    contents = {}
    for frame in range(len(bitstreams)):
        data = bitstreams.read(frame)
        suffix = next((suffix for magic, suffix in _SUFFIXES.items() if data.startswith(magic)), ".bin")
        contents[f"{frame:06}{suffix}"] = data
    atomic.write_folder(out, contents)
    click.echo(f"{out}: {counted(len(contents), 'file')}")


def _write_video(bitstreams: BitstreamFile, job: CodingJob, frame_rate_hz: float, out: Path) -> None:
    plugins = registry.installed()
    codec = (
        None
        if plugins.find("codec", job.codec.name).hosted
        else plugins.create("codec", job.codec.name, job.codec.params)
    )
    if not frame_rate_hz:
        raise click.UsageError(f"the plan has no frame rate for {job.sequence.name}; give --frame-rate")
    if not isinstance(codec, codecs.VideoCodec):
        raise click.UsageError(f"video files cannot contain the packets of {job.codec.full_name}")
    packets = [sent.packet(bitstreams.read(sent.frame)) for sent in bitstreams.packets]
    content = muxing.file_from_packets(codec, packets, frame_rate_hz, out.name)
    atomic.write_file(out, content)
    click.echo(f"{out}: {counted(len(packets), 'frame')}, {len(content)} bytes")
