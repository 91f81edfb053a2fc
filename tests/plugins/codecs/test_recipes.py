"""Recipes against what codecbench itself sends: each text is run as it is pasted, and its bytes are counted.

The oracles are the stacks: OpenCV, PyAV, imagecodecs and glymur, FFmpeg and GStreamer where they are installed. ROS 2
is not: its YAML has to have the keys and types that the packages declare, and FFmpeg is opened with it as the source
of ffmpeg_image_transport 3.0 opens it.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from ruamel.yaml import YAML

from codecbench import AnyCodec, Image, Recipe, Scene, encoder_of, gray_from_image
from codecbench.core.contracts.image import Layout, layout_of
from codecbench.core.engine.plugins.registry import installed

RATE_HZ = 30.0
NEAR = 0.05
DIFFERS = ("smaller", "larger", "depend on", "gave", "less exactly", "always has a tune")
"""Words of notes that say that other bytes are sent."""
COMPRESSED = {"format": str, "jpeg_quality": int, "png_level": int}
COMPRESSED_DEPTH = {"format": str, "png_level": int, "depth_max": float, "depth_quantization": float}
TRANSPORT = {
    "encoder": str, "encoder_av_options": str, "pixel_format": str, "qmax": int, "bit_rate": int, "gop_size": int,
    "max_b_frames": int, "encoder_measure_performance": bool,
}  # fmt: skip

SHIPPED = [plugin for plugin in installed().plugins("codec") if not plugin.hosted]
EXAMPLES = [
    pytest.param(plugin.spec.name, place, id=f"{plugin.spec.name}-{place}")
    for plugin in SHIPPED
    if plugin.missing is None
    for place in range(len(installed().load("codec", plugin.spec.name).examples))
]


SETTINGS = [
    pytest.param(*example.values, layout, id=f"{example.id}-{layout}")
    for example in EXAMPLES
    for layout in installed().load("codec", example.values[0]).capabilities.layouts
]


@cache
def pictures(channels: int, bits: int = 8) -> list[Image]:
    """Parts of the first frames of the built-in sequence; those of 16 bits in steps of 16."""
    sequence = installed().create("dataset", "synthetic", {"frames": 12}).open()
    parts = [frame.image[100:260, 100:340] for frame in sequence]
    images = [gray_from_image(image) if channels == 1 else image.copy() for image in parts]
    return images if bits == 8 else [16 * image.astype(np.uint16) for image in images]


def scene_of(images: list[Image]) -> Scene:
    layout = layout_of(images[0])
    return Scene(*images[0].shape[:2], layout.channels, RATE_HZ, layout.bits)


def example(name: str, place: int) -> AnyCodec[Any]:
    cls = installed().load("codec", name)
    codec: AnyCodec[Any] = cls.create(**cls.examples[place])
    return codec


def sent(codec: AnyCodec[Any], images: list[Image]) -> int:
    encoder = encoder_of(codec, RATE_HZ)
    packets = [packet for image in images for packet in encoder.push(image)]
    return sum(len(packet.data) for packet in [*packets, *encoder.flush()])


def sent_by_python(recipe: Recipe, images: list[Image], *, holds_back: bool) -> int:
    names: dict[str, Any] = {}
    exec(recipe.text, names)
    encode = names["encode"]
    is_bgr = encode.__code__.co_varnames[0] == "bgr"
    sizes = [len(encode(cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if is_bgr else image)) for image in images]
    return sum(sizes) + (len(encode(None)) if holds_back else 0)


def recipes(codec: AnyCodec[Any], scene: Scene, language: str) -> list[Recipe]:
    return [each for each in codec.recipes(scene) if each.language == language and each.text]


def parameters(recipe: Recipe) -> dict[str, Any]:
    found: dict[str, Any] = YAML(typ="safe").load(recipe.text)["/**"]["ros__parameters"]["image_raw"]
    return found


@pytest.mark.parametrize(("name", "place", "layout"), SETTINGS)
def test_every_setting_has_a_python_recipe_that_sends_what_was_measured(name: str, place: int, layout: Layout) -> None:
    codec = example(name, place)
    images = pictures(*layout)[: 2 if codec.stateless else None]
    found = recipes(codec, scene_of(images), "python")
    assert found
    measured = sent(codec, images)
    for recipe in found:
        if not any(word in recipe.note for word in DIFFERS):
            own = sent_by_python(recipe, images, holds_back=not codec.stateless)
            assert own == pytest.approx(measured, rel=NEAR), recipe.stack


@pytest.mark.parametrize(("width", "height"), [(239, 159), (50, 40)])
def test_frames_of_odd_and_small_sides_are_padded_as_they_were(width: int, height: int) -> None:
    images = [image[:height, :width].copy() for image in pictures(3)]
    codec = installed().create("codec", "hevc", {"crf": 35}) if width < 72 else example("h264", 0)
    (recipe,) = recipes(codec, scene_of(images), "python")
    assert sent_by_python(recipe, images, holds_back=True) == pytest.approx(sent(codec, images), rel=NEAR)
    sides = codec.params.traits.coded_size(width, height)
    notes = [each.note for each in codec.recipes(scene_of(images)) if "ROS" in each.stack or "GStreamer" in each.stack]
    assert notes
    assert all(f"Pad frames to {sides[0]}x{sides[1]}" in note for note in notes)


@pytest.mark.parametrize(("name", "place"), EXAMPLES)
def test_ros_parameters_are_those_that_the_packages_declare(name: str, place: int) -> None:
    codec = example(name, place)
    depth = codec.recipes(Scene(480, 640, 1, RATE_HZ, 16)) if 16 in codec.capabilities.bits else ()
    for recipe in depth:
        if "compressed_depth_image_transport" in recipe.stack:
            own = parameters(recipe)["compressedDepth"]
            assert {key: type(value) for key, value in own.items()} == {key: COMPRESSED_DEPTH[key] for key in own}
    for recipe in recipes(codec, Scene(480, 640, 3, RATE_HZ), "yaml") if 3 in codec.capabilities.channels else ():
        found = parameters(recipe)
        if "compressed_image_transport" in recipe.stack:
            own = found.pop("compressed")
            assert own == found  # Humble has the same keys a level higher
            declared: dict[str, type] = COMPRESSED
        else:
            own, declared = found["ffmpeg"], TRANSPORT
            words = own["encoder_av_options"].split(",")
            assert all(len(word.split(":")) == 2 for word in words)  # others are skipped as bad
        assert own
        assert {key: type(value) for key, value in own.items()} == {key: declared[key] for key in own}


def test_jpeg_by_ros_is_what_opencv_writes_by_quality_alone() -> None:
    codec, images = installed().create("codec", "jpeg", {"quality": 37}), pictures(3)[:2]
    (recipe,) = recipes(codec, scene_of(images), "yaml")
    quality = parameters(recipe)["compressed"]["jpeg_quality"]
    frames = [cv2.cvtColor(image, cv2.COLOR_RGB2BGR) for image in images]
    written = [cv2.imencode(".jpg", frame, [cv2.IMWRITE_JPEG_QUALITY, quality])[1] for frame in frames]
    assert sum(map(len, written)) == pytest.approx(sent(codec, images), rel=NEAR)


@pytest.mark.parametrize(
    ("name", "params"),
    [
        ("h264", {"crf": 28}),
        ("h264", {"crf": 28, "latency": "any"}),
        ("h264", {"bitrate_kbps": 150}),
        ("hevc", {"crf": 24}),
    ],
    ids=["h264-crf", "h264-any", "h264-bitrate", "hevc-crf"],
)
def test_ffmpeg_opened_as_the_transport_opens_it_sends_what_was_measured(name: str, params: dict[str, Any]) -> None:
    """A context for 100 frames a second, options to the encoder alone, frames converted by swscale."""
    av = pytest.importorskip("av", reason="the extra `video` is not installed")
    codec, images = installed().create("codec", name, {**params, "gop": 6}), pictures(3)
    (recipe,) = recipes(codec, scene_of(images), "yaml")
    own = parameters(recipe)["ffmpeg"]
    context = av.CodecContext.create(own["encoder"], "w")
    context.width, context.height, context.pix_fmt = images[0].shape[1], images[0].shape[0], own["pixel_format"]
    context.framerate, context.time_base = Fraction(100), Fraction(1, 100)
    context.options = dict(word.split(":") for word in own["encoder_av_options"].split(","))
    context.options |= {"g": str(own["gop_size"]), "bf": str(own["max_b_frames"])}
    context.options |= {"b": str(own["bit_rate"])}
    sizes, starts = 0, 0
    for number, image in enumerate([*images, None]):
        frame = None
        if image is not None:
            bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
            frame = av.VideoFrame.from_ndarray(bgr, format="bgr24")
            frame = frame.reformat(format=context.pix_fmt, interpolation="FAST_BILINEAR")
            frame.pts = number
        packets = context.encode(frame)
        sizes += sum(packet.size for packet in packets)
        starts += sum(packet.is_keyframe for packet in packets)
    notes_of_x265 = 2000 * starts if name == "hevc" else 0
    assert sizes - notes_of_x265 == pytest.approx(sent(codec, images), rel=2 * NEAR)


@pytest.mark.thorough
@pytest.mark.parametrize("program", ["ffmpeg", "gst-launch-1.0"])
@pytest.mark.parametrize(("name", "place", "layout"), SETTINGS)
def test_commands_send_what_was_measured(name: str, place: int, layout: Layout, program: str, tmp_path: Path) -> None:
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    codec = example(name, place)
    images = pictures(*layout)[: 2 if codec.stateless else None]
    for number, image in enumerate(images):
        shown = image if layout.channels == 1 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
        assert cv2.imwrite(str(tmp_path / f"{number:06}.png"), shown)
    for recipe in recipes(codec, scene_of(images), "sh"):
        if not recipe.text.startswith(program):
            continue
        folder = tmp_path / program
        folder.mkdir()
        done = subprocess.run(
            _from_files(recipe.text, len(images)), shell=True, cwd=folder, capture_output=True, text=True, check=False
        )
        if "no element" in done.stderr or "Unknown encoder" in done.stderr:
            pytest.skip(done.stderr.strip()[:200])
        assert done.returncode == 0, done.stderr
        if not any(word in recipe.note for word in DIFFERS):
            own = sum(path.stat().st_size for path in folder.iterdir())
            assert own == pytest.approx(sent(codec, images), rel=NEAR), recipe.text


def _from_files(command: str, frames: int) -> str:
    """A command that reads PNG files in place of a camera."""
    camera = r"-f v4l2 (-framerate \S+) -video_size \S+ -i /dev/video0"
    command = re.sub(camera, rf"-v error \1 -i ../%06d.png -frames:v {frames}", command)
    files = rf"-q multifilesrc location=../%06d.png caps=image/png,framerate=30/1 stop-index={frames - 1} ! pngdec !"
    return re.sub(r"-e v4l2src .*? ! video/x-raw,\S+ !", files, command)
