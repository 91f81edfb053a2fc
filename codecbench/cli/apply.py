"""`codecbench apply`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from codecbench.cli.completion import codec_names
from codecbench.cli.saying import say
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
              help="The pick of this codec in place of the answer; may be given more than once.")  # fmt: skip
@click.option("--setting", default="", metavar="'KEY=VALUE ...'", help="Which setting of the --codec, not its pick.")
@click.option("--stack", "stacks", multiple=True, metavar="WORD",
              help="Only stacks with this word in their name, such as ros; may be given again.")  # fmt: skip
@click.option("--frame-rate", "frame_rate_hz", type=click.FloatRange(min=0, min_open=True), metavar="HZ",
              help="That of the camera; the default is that of the sequence.")  # fmt: skip
@click.option("--size", metavar="WIDTHxHEIGHT", help="That of the camera; the default is that of the sequence.")
def apply(
    run: Path,
    codecs: tuple[str, ...],
    setting: str,
    stacks: tuple[str, ...],
    frame_rate_hz: float | None,
    size: str | None,
) -> None:
    """Print what one pastes into a robot for the setting that the answer of RUN takes.

    For each stack that the codec has a recipe for: parameters of ROS 2, a GStreamer pipeline, a command of ffmpeg, a
    call from Python; and a note where that stack does not code what was measured.
    """

    if setting and len(codecs) != 1:
        raise click.UsageError("--setting is of one codec; give one --codec")
    result = collect.open_nonempty_run(run)
    picks = {link: views.picked(result, link) for link in choosing.links_read(result) or [""]}
    taken = dict.fromkeys((found[0].codec, found[0].setting) for found in picks.values() if found and found[0].passes)
    chosen = [_job(result, codec, label=label) for codec, label in taken]
    if codecs:
        chosen = []
        for name in codecs:
            own = dict.fromkeys(pick.setting for found in picks.values() for pick in found if pick.codec == name)
            labels: list[str | None] = [None] if setting or not own else [*own]
            chosen += [_job(result, name, setting, label) for label in labels]
    elif not chosen:
        for sentence in answers.answers(result).sentence.splitlines():
            say(sentence)
        say("Nothing to apply; --codec NAME prints the recipes of a codec all the same.")
        return
    scene = _scene(run, chosen[0], frame_rate_hz, size)
    for job in chosen:
        name = f"{job.codec.name} {job.codec.label}".strip()
        passes, nearest = (views.Pick(job.codec.name, job.codec.label, each) for each in (True, False))
        over = [link for link, found in picks.items() if passes in found]
        verdict = f"; passes over {' and '.join(over)}" if any(over) else ""
        if not over:
            is_nearest = any(nearest in found for found in picks.values())
            verdict = "; it is not known to pass" if is_nearest else "; it is not a pick of the answer"
        _comment(f"{name}: {_measured(result, job)}{verdict}", bold=True)
        _comment(f"for frames of {scene.width}x{scene.height}; /dev/video0, image_raw and out.* are to be your own")
        click.echo()
        for recipe in _recipes(plugins.installed(), job.codec, scene):
            if not stacks or any(word.lower() in recipe["stack"].lower() for word in stacks):
                _show(recipe)


def _comment(text: str, *, bold: bool = False, fg: str | None = None) -> None:
    """Print a line that is a comment in YAML, shells and Python, so that all may be pasted; none is wrapped."""

    click.secho(f"# {clean_line(text)}", bold=bold, fg=fg)


def _show(recipe: dict[str, Any]) -> None:
    """A heading, the note, and the text as it is."""

    _comment(recipe["stack"], bold=True)
    if recipe["note"]:
        _comment(recipe["note"], fg="yellow")
    if recipe["text"]:
        click.echo(clean_text(recipe["text"]))
    click.echo()


def _job(result: RunResult, codec: str, setting: str = "", label: str | None = None) -> CodingJob:
    """The setting that is meant, on the first sequence that has it. Raises UsageError where it is none or several."""

    wanted = settings.setting_from_text(setting)
    own = [job for job in result.plan.jobs if job.codec.name == codec]
    found: dict[str, CodingJob] = {}
    for job in own:
        if label in (None, job.codec.label) and wanted.items() <= job.codec.params.items():
            found.setdefault(job.codec.label, job)
    if len(found) == 1:
        return next(iter(found.values()))
    if not own:
        names = ", ".join(dict.fromkeys(job.codec.name for job in result.plan.jobs))
        raise click.UsageError(f"the run has no codec {codec}; it has: {names}")
    labels = "; ".join(found or dict.fromkeys(job.codec.label for job in own))
    if found:
        raise click.UsageError(f"several settings of {codec} are meant; say which by --setting: {labels}")
    raise click.UsageError(f"the run has no {codec} {setting}; it has: {labels}")


def _measured(result: RunResult, job: CodingJob) -> str:
    """`0.544 Mbit/s at 30 fps, 2.27 kB a frame measured on SEQUENCE`, as far as it was measured."""

    kbps, frame_bytes = costs.rate_of_setting(result, job.sequence.name, job.codec.name, job.codec.label)
    pace = f" at {kbps * 125 / frame_bytes:.3g} fps" if frame_bytes > 0 else ""
    words = [f"{tables.three_digits(kbps / 1e3)} Mbit/s{pace}"] if kbps > 0 else []
    words += [f"{tables.three_digits(frame_bytes / 1e3)} kB a frame"] if frame_bytes > 0 else []
    several = len(result.plan.sequences)
    on = f"{job.sequence.name}, one of {counted(several, 'sequence')}" if several > 1 else job.sequence.name
    return f"{', '.join(words) or 'no rate was'} measured on {on}"


def _scene(run: Path, job: CodingJob, frame_rate_hz: float | None, size: str | None) -> Scene:
    """The frames of the robot: what is given, and else those of the sequence, which is opened for it."""

    dataset = job.sequence.dataset
    found: Sequence[float] = (math.nan, 0, 0)
    if frame_rate_hz is None or size is None:
        elsewhere = plan_file.PlanFile(run).origin_elsewhere()
        if elsewhere is not None:
            message = f"the run was made in {elsewhere}, so its sequence is not opened"
            raise click.UsageError(f"{message}; give --frame-rate and --size")
        try:
            found = plugins.installed().ask(frames_of, dataset.name, dataset.params, of=[("dataset", dataset.name)])
        except CodecbenchError as error:
            raise click.UsageError(f"{error}; give --frame-rate and --size, and no sequence is opened") from error
    width, height = (int(side) for side in found[1:])
    if size is not None:
        sides = size.split("x")
        if len(sides) != 2 or not all(side.isdecimal() and int(side) > 0 for side in sides):
            raise click.UsageError(f"--size {size}: not WIDTHxHEIGHT in pixels, such as 640x480")
        width, height = map(int, sides)
    return recipes.Scene(height, width, job.sequence.channels, found[0] if frame_rate_hz is None else frame_rate_hz)


def frames_of(registry: Registry, dataset: str, params: dict[str, Any]) -> list[float]:
    """Frame rate, width and height of a sequence, asked where its plugin may be loaded."""
    sequence = registry.create("dataset", dataset, params).open()
    height, width = sequence.read(0).image.shape[:2]
    return [float(sequence.frame_rate_hz), width, height]


def _recipes(registry: Registry, setting: PluginSetting, scene: Scene) -> list[dict[str, Any]]:
    """What a codec says, wherever its plugin may be loaded. Raises CodecbenchError where it cannot be asked."""
    asked = (setting.name, setting.params, asdict(scene))
    found: list[dict[str, Any]] = registry.ask(recipes_of, *asked, of=[("codec", setting.name)])
    return found


def recipes_of(registry: Registry, codec: str, params: dict[str, Any], scene: dict[str, Any]) -> list[dict[str, Any]]:
    """The recipes of a setting as JSON types. Raises PluginError where the codec says something else."""

    found = registry.create("codec", codec, params).recipes(recipes.Scene(**scene))
    if not isinstance(found, tuple) or not all(isinstance(each, recipes.Recipe) for each in found):
        raise PluginError(f"codec {codec}: recipes returned {type(found).__name__}, not a tuple of Recipe")
    return [asdict(each) for each in found]
