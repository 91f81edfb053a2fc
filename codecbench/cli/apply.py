"""`codecbench apply`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from codecbench.cli.messages import say
from codecbench.cli.parameters import codec_names
from codecbench.core.analysis import choosing, collect
from codecbench.core.conformance import settings
from codecbench.core.contracts import recipe as recipes
from codecbench.core.contracts.errors import CodecbenchError, PluginError
from codecbench.core.engine.plugins import registry as plugins
from codecbench.core.engine.storage import plan_file
from codecbench.core.engine.text import clean_line, clean_text, counted
from codecbench.core.report import answers, costs, tables, views

if TYPE_CHECKING:
    from codecbench.core.analysis.run_result import RunResult
    from codecbench.core.contracts.recipe import Scene
    from codecbench.core.engine.planning.model import CodingJob, PluginSetting
    from codecbench.core.engine.plugins.registry import Registry


@click.command()
@click.argument("run", type=click.Path(path_type=Path))
@click.option("--codec", "codecs", multiple=True, shell_complete=codec_names,
              help="Use this codec's pick instead of the recommended setting; repeatable.")  # fmt: skip
@click.option("--setting", default="", metavar="'KEY=VALUE ...'", help="Setting of the --codec instead of its pick.")
@click.option("--stack", "stacks", multiple=True, metavar="WORD",
              help="Print only stacks with this word in their name, such as ros; repeatable.")  # fmt: skip
@click.option("--frame-rate", "frame_rate_hz", type=click.FloatRange(min=0, min_open=True), metavar="HZ",
              help="Frame rate of the camera; default: that of the sequence.")  # fmt: skip
@click.option("--size", metavar="WIDTHxHEIGHT", help="Frame size of the camera; default: that of the sequence.")
def apply(
    run: Path,
    codecs: tuple[str, ...],
    setting: str,
    stacks: tuple[str, ...],
    frame_rate_hz: float | None,
    size: str | None,
) -> None:
    """Print configuration to paste into a robot, for the recommended setting of RUN.

    For each stack that the codec has a recipe for: ROS 2 parameters, a GStreamer pipeline, an ffmpeg command or a
    Python call. A note marks stacks that code something else than what was measured.
    """
    if setting and len(codecs) != 1:
        raise click.UsageError("--setting needs exactly one --codec")
    result = collect.open_nonempty_run(run)
    picks_by_link = {link: views.answer_picks(result, link) for link in choosing.links_with_readers(result) or [""]}
    first_picks = [picks[0] for picks in picks_by_link.values() if picks]
    answer = dict.fromkeys((pick.codec, pick.setting) for pick in first_picks if pick.passes)
    jobs = [_job(result, codec, label=label) for codec, label in answer]
    if codecs:
        jobs = []
        for name in codecs:
            picks = [pick for link_picks in picks_by_link.values() for pick in link_picks if pick.codec == name]
            picked = dict.fromkeys(pick.setting for pick in picks)
            labels: list[str | None] = [None] if setting or not picked else [*picked]
            jobs += [_job(result, name, setting, label) for label in labels]
    elif not jobs:
        for sentence in answers.answers(result).sentence.splitlines():
            say(sentence)
        say("Nothing to apply; --codec NAME prints a codec's recipes anyway.")
        return
    scene = _scene(run, jobs[0], frame_rate_hz, size)
    for job in jobs:
        name = f"{job.codec.name} {job.codec.label}".strip()
        passing, nearest = (views.Pick(job.codec.name, job.codec.label, passes) for passes in (True, False))
        links = [link for link, picks in picks_by_link.items() if passing in picks]
        verdict = f"; passes over {' and '.join(links)}" if any(links) else ""
        if not links:
            is_nearest = any(nearest in picks for picks in picks_by_link.values())
            verdict = "; not shown to pass" if is_nearest else "; not one of the picks"
        _comment(f"{name}: {_describe_rate(result, job)}{verdict}", bold=True)
        _comment(f"for frames of {scene.width}x{scene.height}; replace /dev/video0, image_raw and out.* with your own")
        click.echo()
        for recipe in _recipes(plugins.installed(), job.codec, scene):
            if not stacks or any(word.lower() in recipe["stack"].lower() for word in stacks):
                _show(recipe)


def _comment(text: str, *, bold: bool = False, fg: str | None = None) -> None:
    """Print a line as a comment of YAML, shells and Python, so that users can paste all output. It is not wrapped."""
    click.secho(f"# {clean_line(text)}", bold=bold, fg=fg)


def _show(recipe: dict[str, Any]) -> None:
    """Print the heading, the note and the text of a recipe."""
    _comment(recipe["stack"], bold=True)
    if recipe["note"]:
        _comment(recipe["note"], fg="yellow")
    if recipe["text"]:
        click.echo(clean_text(recipe["text"]))
    click.echo()


def _job(result: RunResult, codec: str, setting: str = "", label: str | None = None) -> CodingJob:
    """Return the coding job of a setting on the first sequence. Raises UsageError if none or several settings match."""
    wanted = settings.setting_from_text(setting)
    jobs = [job for job in result.plan.jobs if job.codec.name == codec]
    matches: dict[str, CodingJob] = {}
    for job in jobs:
        if label in (None, job.codec.label) and wanted.items() <= job.codec.params.items():
            matches.setdefault(job.codec.label, job)
    if len(matches) == 1:
        return next(iter(matches.values()))
    if not jobs:
        names = ", ".join(dict.fromkeys(job.codec.name for job in result.plan.jobs))
        raise click.UsageError(f"the run has no codec {codec}; it has: {names}")
    labels = "; ".join(matches or dict.fromkeys(job.codec.label for job in jobs))
    if matches:
        raise click.UsageError(f"several settings of {codec} match; select one with --setting: {labels}")
    raise click.UsageError(f"the run has no {codec} {setting}; it has: {labels}")


def _describe_rate(result: RunResult, job: CodingJob) -> str:
    """Return such as `0.544 Mbit/s at 30 fps, 2.27 kB a frame measured on SEQUENCE`, as far as it was measured."""
    kbps, frame_bytes = costs.rate_of_setting(result, job.sequence.name, job.codec.name, job.codec.label)
    pace = f" at {kbps * 125 / frame_bytes:.3g} fps" if frame_bytes > 0 else ""
    words = [f"{tables.three_digits(kbps / 1e3)} Mbit/s{pace}"] if kbps > 0 else []
    words += [f"{tables.three_digits(frame_bytes / 1e3)} kB a frame"] if frame_bytes > 0 else []
    several = len(result.plan.sequences)
    sequence = f"{job.sequence.name}, one of {counted(several, 'sequence')}" if several > 1 else job.sequence.name
    return f"{', '.join(words) or 'no rate was'} measured on {sequence}"


def _scene(run: Path, job: CodingJob, frame_rate_hz: float | None, size: str | None) -> Scene:
    """Return the rate and size of the robot's frames: as given, and else those of the sequence, which is opened."""
    dataset = job.sequence.dataset
    facts: Sequence[float] = (math.nan, 0, 0)
    if frame_rate_hz is None or size is None:
        elsewhere = plan_file.PlanFile(run).origin_elsewhere()
        if elsewhere is not None:
            message = f"the run was made in {elsewhere}, so its sequence is not opened"
            raise click.UsageError(f"{message}; give --frame-rate and --size")
        try:
            facts = plugins.installed().ask(frames_of, dataset.name, dataset.params, of=[("dataset", dataset.name)])
        except CodecbenchError as error:
            raise click.UsageError(f"{error}; give --frame-rate and --size to avoid opening the sequence") from error
    width, height = (int(side) for side in facts[1:])
    if size is not None:
        sides = size.split("x")
        if len(sides) != 2 or not all(side.isdecimal() and int(side) > 0 for side in sides):
            raise click.UsageError(f"--size {size}: not WIDTHxHEIGHT in pixels, such as 640x480")
        width, height = map(int, sides)
    layout, rate = job.sequence.layout, facts[0] if frame_rate_hz is None else frame_rate_hz
    return recipes.Scene(height, width, layout.channels, rate, layout.bits)


def frames_of(registry: Registry, dataset: str, params: dict[str, Any]) -> list[float]:
    """Return frame rate, width and height of a sequence. Runs in the process that may load its plugin."""
    sequence = registry.create("dataset", dataset, params).open()
    height, width = sequence.read(0).image.shape[:2]
    return [float(sequence.frame_rate_hz), width, height]


def _recipes(registry: Registry, setting: PluginSetting, scene: Scene) -> list[dict[str, Any]]:
    """Ask a codec for its recipes in the process that may load its plugin. Raises CodecbenchError if that fails."""
    arguments = (setting.name, setting.params, asdict(scene))
    answer: list[dict[str, Any]] = registry.ask(recipes_of, *arguments, of=[("codec", setting.name)])
    return answer


def recipes_of(registry: Registry, codec: str, params: dict[str, Any], scene: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the recipes of a setting as JSON types. Raises PluginError if the codec returns something else."""
    answer = registry.create("codec", codec, params).recipes(recipes.Scene(**scene))
    if not isinstance(answer, tuple) or not all(isinstance(recipe, recipes.Recipe) for recipe in answer):
        raise PluginError(f"codec {codec}: recipes returned {type(answer).__name__}, not a tuple of Recipe")
    return [asdict(recipe) for recipe in answer]
