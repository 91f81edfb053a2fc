"""`codecbench apply`: what is printed of a finished run, by the installed command."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from click.testing import CliRunner
from distributions import install_source
from installed_command import Done, Place, tiny_place
from ruamel.yaml import YAML

from codecbench import Recipe
from codecbench.cli import cli
from codecbench.cli.apply import _describe_rate, recipes_of
from codecbench.core.contracts.errors import PluginError
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.storage.store import Store

MATRIX = """
version: 1
name: coded
sequences: [{use: synthetic, params: {frames: 8}}]
codecs:
  - {use: jpeg, params: {quality: {grid: [95, 100]}}}
  - {use: webp}
  - {use: raw}
evaluators: [quality, features]
run: {workers: 1}
"""
BROKEN = """
import numpy as np

from codecbench import Capabilities, Codec, NoParams, PluginSpec, hookimpl

class Broken(Codec[NoParams]):
    name, version, params_type = "broken", "1", NoParams
    capabilities = Capabilities()

    def encode(self, image, *, trace=None):
        return b"%d %d" % image.shape[:2]

    def decode(self, bitstream, *, trace=None):
        return np.zeros([int(side) for side in bitstream.split()], np.uint8)

    def recipes(self, scene):
        raise KeyError("on purpose")

@hookimpl
def codecbench_codecs():
    return [PluginSpec("broken", "broken_recipes:Broken", "raises")]
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    pytest.importorskip("imagecodecs", reason="the extra `codecs` is not installed")
    found = Place(tmp_path_factory.mktemp("apply"))
    (found.folder / "coded.yaml").write_text(MATRIX)
    done = found.call("run", "coded.yaml", "--quiet")
    assert done.status == 0, done.output
    return found


def applied(place: Place, *words: str, status: int = 0) -> Done:
    done = place.call("apply", "runs/coded", *words)
    assert done.status == status, done.output
    return done


def test_the_answer_is_what_is_applied(place: Place) -> None:
    """Its setting and its measured rate in the first line, then every stack with its text as it is."""
    answer = place.call("rank", "runs/coded", COLUMNS="2000").stdout.strip().splitlines()[-1]
    shown = applied(place).stdout
    head = shown.splitlines()[0].removeprefix("# ")
    codec = answer.removeprefix("Use ").split(":")[0].removesuffix(" or coarser").strip()
    assert answer.startswith("Use ")
    assert head.startswith(codec)
    assert f"{answer.split(': ')[1].split(' (')[0]}, " in head  # `4.36 Mbit/s at 30 fps`
    assert "\x1b" not in shown
    assert "640x480" in shown


def test_a_setting_that_is_named_is_applied_as_it_is(place: Place) -> None:
    shown = applied(place, "--codec", "jpeg", "--setting", "quality=95", "--stack", "ROS").stdout
    blocks = shown.split("\n\n")
    kbps, frame_bytes = _measured(place, "jpeg", "quality=95")
    assert blocks[0].startswith(
        f"# jpeg quality=95: {kbps / 1e3:.3g} Mbit/s at 30 fps, {frame_bytes / 1e3:.3g} kB a frame"
    )
    found = YAML(typ="safe").load(blocks[1])["/**"]["ros__parameters"]["image_raw"]
    assert found["compressed"] == {"format": "jpeg", "jpeg_quality": 95}
    assert "GStreamer" not in shown


def _measured(place: Place, codec: str, setting: str) -> tuple[float, float]:
    rows = json.loads(place.call("table", "runs/coded", "--format", "json").stdout)
    (row,) = (row for row in rows if (row["codec"], row["setting"]) == (codec, setting))
    return row["quality.bitrate_kbps.mean"], row["quality.size_bytes.mean"]


def test_the_camera_of_the_robot_may_be_another(place: Place) -> None:
    shown = applied(place, "--codec", "webp", "--size", "320x200", "--frame-rate", "15", "--stack", "GStreamer").stdout
    assert "width=320,height=200,framerate=15/1" in shown


@pytest.mark.parametrize(
    ("words", "fact"),
    [
        (["--codec", "h264"], "no codec h264"),
        (["--codec", "jpeg", "--setting", "quality=3"], "it has: quality=95; quality=100"),
        (["--codec", "jpeg", "--setting", "optimize=false"], "--setting: quality=95; quality=100"),
        (["--setting", "quality=95"], "exactly one --codec"),
        (["--size", "640"], "not WIDTHxHEIGHT"),
    ],
)
def test_wrong_options_name_what_the_run_has(place: Place, words: list[str], fact: str) -> None:
    assert fact in applied(place, *words, status=2).stderr


def test_a_run_without_a_recommendation_applies_a_given_codec(tmp_path: Path) -> None:
    tiny = tiny_place(tmp_path)
    done = tiny.call("apply", "runs/tiny")
    assert done.status == 0
    *_, answer = tiny.call("rank", "runs/tiny").stdout.strip().splitlines()
    sentence, hint = done.stdout.splitlines()
    assert sentence == answer
    assert "--codec NAME" in hint
    head, *recipe = tiny.call("apply", "runs/tiny", "--codec", "shift").stdout.splitlines()
    assert head.startswith("# shift: ")
    assert "the picks" in head
    assert any("codecbench.codec(" in line for line in recipe)


def test_a_codec_whose_recipes_raise_is_named(tmp_path: Path) -> None:
    tiny = tiny_place(tmp_path)
    install_source(tiny.site, "broken-recipes", "1", BROKEN)
    (tmp_path / "broken.yaml").write_text(
        "{version: 1, name: broken, sequences: [{use: ramp}], codecs: [broken], evaluators: [error]}"
    )
    assert tiny.call("run", "broken.yaml").status == 0
    done = tiny.call("apply", "runs/broken", "--codec", "broken")
    assert done.status == 2, done.output
    assert "on purpose" in done.stderr
    assert "broken" in done.stderr


def test_recipes_have_to_be_recipes(monkeypatch: pytest.MonkeyPatch) -> None:
    class Odd:
        def recipes(self, scene: object) -> Any:
            return [Recipe("s", "sh", "t")]

    registry = installed()
    monkeypatch.setattr(registry, "create", lambda *_: Odd())
    scene = {"height": 1, "width": 1, "channels": 1, "frame_rate_hz": 30.0}
    with pytest.raises(PluginError, match=r"^codec odd: .* list"):
        recipes_of(registry, "odd", {}, scene)


def test_a_run_from_elsewhere_asks_for_the_camera(place: Place, tmp_path: Path) -> None:
    """Its plan names another machine, so that no dataset of it is opened."""
    folder = place.folder / "runs" / "coded"
    assert Store(folder).read_plan().jobs
    elsewhere = tmp_path / "run"
    place.call("bundle", "runs/coded", "--out", str(tmp_path / "b.zip"))
    done = place.call("open", str(tmp_path / "b.zip"), "--out", str(elsewhere))
    assert done.status == 0, done.output
    result = CliRunner().invoke(cli, ["apply", str(elsewhere), "--codec", "webp"])
    assert result.exit_code == 2
    assert "give --frame-rate and --size" in result.output
    result = CliRunner().invoke(
        cli, ["apply", str(elsewhere), "--codec", "webp", "--frame-rate", "30", "--size", "640x480"]
    )
    assert result.exit_code == 0, result.output
    assert "webpenc" in result.output


@pytest.mark.parametrize(
    ("rate", "numbers"),
    [
        ((500.0, 2000.0), ["0.5 Mbit/s", "31.2 fps", "2 kB"]),
        ((500.0, math.nan), ["0.5 Mbit/s"]),
        ((math.nan, 2000.0), ["2 kB"]),
        ((math.nan, math.nan), []),
    ],
)
def test_what_is_not_measured_of_a_rate_is_left_out(
    rate: tuple[float, float], numbers: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("codecbench.core.report.costs.rate_of_setting", lambda *_: rate)
    job = SimpleNamespace(sequence=SimpleNamespace(name="office"), codec=SimpleNamespace(name="jpeg", label=""))
    text = _describe_rate(SimpleNamespace(plan=SimpleNamespace(sequences=[job.sequence])), job)  # type: ignore[arg-type]
    assert re.findall(r"[\d.]+ \S+(?<!,)", text) == numbers
    assert text.endswith("measured on office")
