"""Recipes of the stacks that several codecs share: the text around the options of a codec's operating point.

Keys are those of ROS 2 compressed_image_transport 2.5 to 6.2, GStreamer 1.22 and FFmpeg 5.1.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from codecbench.core.contracts.recipe import Recipe, Scene

COMPRESSED: Final = "ROS 2 compressed_image_transport 2.5 to 6.2 (Humble to Rolling)"
COMPRESSED_DEPTH: Final = "ROS 2 compressed_depth_image_transport 4.0 to 6.2 (Jazzy to Rolling)"
MAX_DEPTH_M: Final = 65.535
"""The transport makes greater depths 0; it takes a step of a frame for a millimeter."""
GSTREAMER: Final = "GStreamer 1.22"
FFMPEG: Final = "ffmpeg 5.1"
CONVERSION: Final = "GStreamer converts color less exactly, so lossless and near-lossless frames differ."
FULL_RANGE: Final = "colorimetry=1:4:0:0"
"""Full-range BT.601. Without it GStreamer converts to limited range, with fewer bytes and other pixels."""


def pixel_format(scene: Scene) -> str:
    """Return FFmpeg's name of the layout of the frames."""
    return "rgb24" if scene.channels == 3 else "gray" if scene.bits == 8 else "gray16le"


def sentences(*notes: str) -> str:
    """Join the notes that are not empty."""
    return " ".join(filter(None, notes))


def compressed_image_transport(keys: Mapping[str, str | float], note: str = "", bits: int = 8) -> Recipe:
    """Recipe of parameters for the node that publishes `image_raw`, or depth if it has 16 bits."""
    names = [f"{key}: {value}" for key, value in keys.items()]
    if bits == 16:
        lines = [f"        {key}: {value}" for key, value in {"depth_max": MAX_DEPTH_M, **keys}.items()]
        text = "\n".join(["/**:", "  ros__parameters:", "    image_raw:", "      compressedDepth:", *lines])
        return Recipe(COMPRESSED_DEPTH, "yaml", text, note)
    new, old = ([f"{' ' * indent}{name}" for name in names] for indent in (8, 6))
    lines = ["/**:", "  ros__parameters:", "    image_raw:", "      compressed:", *new, "      # Humble:", *old]
    return Recipe(COMPRESSED, "yaml", "\n".join(lines), note)


def opencv(scene: Scene, extension: str, options: Mapping[str, int | str], note: str = "") -> Recipe:
    """Recipe of an OpenCV call. options: values by name of OpenCV's flags; a string is the name of a value."""
    name = "gray" if scene.channels == 1 else "bgr"
    flags = ", ".join(
        f"cv2.{flag}, {f'cv2.{value}' if isinstance(value, str) else value}" for flag, value in options.items()
    )
    text = f'def encode({name}):\n    return cv2.imencode("{extension}", {name}, [{flags}])[1].tobytes()'
    return Recipe("Python, OpenCV 4.8 and later", "python", f"import cv2\n\n\n{text}", note)


def gstreamer(scene: Scene, caps: str, encoder: str, out: str, note: str = "") -> Recipe:
    """Recipe of a pipeline. caps: of the encoder's input. encoder: elements and properties. out: file or pattern."""
    camera = f"video/x-raw,width={scene.width},height={scene.height},framerate={scene.rate.numerator}"
    sink = "multifilesink" if "%" in out else "filesink"
    source = f"gst-launch-1.0 -e v4l2src device=/dev/video0 ! {camera}/{scene.rate.denominator} ! videoconvert"
    return Recipe(GSTREAMER, "sh", f"{source} ! video/x-raw,{caps} ! {encoder} ! {sink} location={out}", note)


def ffmpeg(scene: Scene, options: Iterable[str], out: str, note: str = "") -> Recipe:
    """Recipe of an ffmpeg command. options: of the encoder. out: file or pattern."""
    camera = f"-f v4l2 -framerate {scene.rate} -video_size {scene.width}x{scene.height} -i /dev/video0"
    return Recipe(FFMPEG, "sh", " ".join(["ffmpeg", camera, *options, out]), note)
