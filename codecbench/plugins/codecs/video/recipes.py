"""Recipes of video encoders for the stacks of robots, made of our own encoder's options.

FFmpeg's command, PyAV and ffmpeg_image_transport take the options of `Encoder.settings`. GStreamer's elements have
properties of their own; options without a property go into their `option-string`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.plugins.codecs.recipes import CONVERSION, FULL_RANGE, GSTREAMER, ffmpeg, gstreamer, sentences
from codecbench.plugins.codecs.video.encoders import VideoParams

_TRANSPORT: Final = "ROS 2 ffmpeg_image_transport 3.0"
_CAMERA_RATE: Final = {"libx264": "x264-params", "libx265": "x265-params"}
"""Option that sets the frame rate in ffmpeg_image_transport, which opens encoders for 100 frames/s."""
_GENERIC: Final = ("g", "b", "maxrate", "minrate", "bufsize", "threads", "bf", "keyint_min", "chroma_sample_location",
                   "x265-params", "svtav1-params")  # fmt: skip
"""Options that it does not take: generic ones, and those with a colon in the value."""
_ENDINGS: Final = {
    "libx264": "h264", "libx265": "hevc", "libsvtav1": "obu", "libvpx-vp9": "ivf", "mjpeg": "mjpeg", "ffv1": "mkv",
}  # fmt: skip
_RAW_FORMATS: Final = {"gray": "I420", "yuv420p": "I420", "yuv444p": "Y444", "rgb": "BGRx"}
_OTHER_BUILD: Final = "Another release of the encoder gives other bytes."
_SVT: Final = "SVT-AV1 1.4 gave 0.75 to 1.2 times the bytes of 4.1."
_UNBOUND: Final = "No option bounds the bit rate (maxrate, bufsize): hevc and VP9 sent 1.06 and 1.07 of the bytes."
_HARDWARE: Final = "Not tested on this hardware."


def recipes(params: VideoParams, scene: Scene) -> Iterator[Recipe]:
    """Yield the recipes of an operating point, that of ROS 2 first."""
    width, height = params.traits.coded_size(scene.width, scene.height)
    pads = ""
    if (width, height) != (scene.width, scene.height):
        pads = f"Pad frames to {width}x{height} first, with copies of their last row and column."
    yield _transport(params, scene, pads)
    yield _gstreamer(params, scene, pads)
    yield _ffmpeg(params, scene, (width, height))
    yield _pyav(params, scene, (width, height))


def _transport_obstacle(params: VideoParams) -> str:
    """Why ffmpeg_image_transport does not support the parameters; empty if it does."""
    encoder = params.traits
    if not encoder.rates:
        return "It converts frames to limited-range yuv420p, so it is not lossless."
    if encoder.intra_only:
        return "It has no key for this encoder's quantizer."
    if encoder.name == "libsvtav1" and params.bitrate_kbps is not None:
        return "At low delay SVT-AV1 needs maxrate with a bit rate, for which it has no key."
    return "It codes color, not gray." if params.pixel_format == "gray" else ""


def _transport(params: VideoParams, scene: Scene, pads: str) -> Recipe:
    encoder, settings = params.traits, params.traits.settings(params)
    if reason := _transport_obstacle(params):
        return Recipe(_TRANSPORT, "yaml", "", reason)
    options = {name: value for name, value in settings.items() if name not in _GENERIC}
    rate = _CAMERA_RATE.get(encoder.name)
    options |= {rate: f"fps={scene.rate}"} if rate else {}
    options |= {"x264opts": "force-cfr=1"} if encoder.name == "libx264" and params.latency == "any" else {}
    options |= {"svtav1-params": "pred-struct=1"} if encoder.name == "libsvtav1" and params.latency == "low" else {}
    keys: dict[str, str | int] = {
        "encoder": encoder.name,
        "encoder_av_options": f'"{",".join(f"{name}:{value}" for name, value in options.items())}"',
        "gop_size": params.gop,
        "max_b_frames": 0 if params.latency == "low" else 3,
        "pixel_format": f"{'yuvj' if rate else 'yuv'}{params.pixel_format[3:]}",
    }
    bit_rate = 0 if params.bitrate_kbps is None else round(params.bitrate_kbps * 1000)
    keys["bit_rate"] = bit_rate if rate else round(bit_rate * 100 / scene.frame_rate_hz)
    lines = [f"        {key}: {value}" for key, value in keys.items()]
    text = "\n".join(["/**:", "  ros__parameters:", "    image_raw:", "      ffmpeg:", *lines])
    timing = (
        f"{rate} sets the camera's frame rate: without it, as in 2.x, the encoder assumes 100 frames/s and sent 0.6 "
        "of the bytes by crf and 0.25 by bit rate. Checked with FFmpeg opened as that package does, not in ROS."
        if rate
        else "The encoder assumes 100 frames/s, which no option corrects, and limited range: by crf AV1 and VP9 "
        "sent 0.82 of the bytes."
    )
    starts = "x265 writes its settings, 2 kB, at each keyframe." if encoder.name == "libx265" else ""
    bound = _UNBOUND if bit_rate else ""
    return Recipe(
        _TRANSPORT, "yaml", text, sentences(pads, timing, bound, starts, _HARDWARE if encoder.hardware else "")
    )


def _ffmpeg(params: VideoParams, scene: Scene, size: tuple[int, int]) -> Recipe:
    encoder = params.traits
    pixel_format = encoder.ffmpeg_format(params)
    filters = [] if size == (scene.width, scene.height) else [f"pad={size[0]}:{size[1]}"]
    options = []
    if params.pixel_format != "rgb":
        filters.append("scale=out_color_matrix=bt601:out_range=full")
        options += ["-color_range", "pc", "-colorspace", "smpte170m"]
    if encoder.name == "mjpeg":
        pixel_format = pixel_format.replace("yuv", "yuvj")
    options += ["-c:v", encoder.name, "-pix_fmt", pixel_format]
    for name, value in encoder.settings(params).items():
        options += ["-b:v" if name == "b" else f"-{name}", value]
    filtering = ["-vf", ",".join(filters)] if filters else []
    notes = [_HARDWARE if encoder.hardware else _OTHER_BUILD, _SVT if encoder.name == "libsvtav1" else ""]
    notes.append("It pads frames with black." if len(filters) > 1 else "")
    return ffmpeg(scene, [*filtering, *options], f"out.{_ENDINGS.get(encoder.name, 'h264')}", sentences(*notes))


def _pyav(params: VideoParams, scene: Scene, size: tuple[int, int]) -> Recipe:
    encoder = params.traits
    layout, source = ("gray", "gray") if scene.channels == 1 else ("rgb", "rgb24")
    pixel_format = encoder.ffmpeg_format(params)
    into = f'"{pixel_format}"'
    if params.pixel_format != "rgb":
        into += ', dst_colorspace="ITU601", dst_color_range="JPEG"'
    below, right = size[1] - scene.height, size[0] - scene.width
    edges = f"((0, {below}), (0, {right}){', (0, 0)' if scene.channels == 3 else ''})"
    pad = f'        {layout} = numpy.pad({layout}, {edges}, mode="edge")\n' if below or right else ""
    text = f"""from fractions import Fraction
from itertools import count

import av
{"import numpy" if pad else ""}
encoder = av.CodecContext.create("{encoder.name}", "w")
encoder.width, encoder.height, encoder.pix_fmt = {size[0]}, {size[1]}, "{pixel_format}"
encoder.framerate = Fraction({scene.rate.numerator}, {scene.rate.denominator})
encoder.time_base = 1 / encoder.framerate
encoder.color_range, encoder.colorspace = 2, 5  # full range, BT.601
encoder.options = {encoder.settings(params)}
numbers = count()


def encode({layout}):
    frame = None
    if {layout} is not None:
{pad}        frame = av.VideoFrame.from_ndarray({layout}, format="{source}").reformat(format={into})
        frame.pts = next(numbers)
    return b"".join(bytes(packet) for packet in encoder.encode(frame))"""
    note = "FFV1's decoder needs encoder.extradata too." if encoder.name == "ffv1" else ""
    return Recipe("Python, PyAV 16 and later", "python", text, sentences(note, _HARDWARE if encoder.hardware else ""))


def _gstreamer(params: VideoParams, scene: Scene, pads: str) -> Recipe:
    name = params.traits.name
    if name not in _ELEMENTS:
        note = "vp9enc has no constant quality without a bit rate; it sent half of the bytes."
        return Recipe(GSTREAMER, "sh", "", note if name == "libvpx-vp9" else f"No element is known for {name}.")
    element, note = _ELEMENTS[name](params)
    caps = f"format={_RAW_FORMATS[params.pixel_format]}"
    gray = "It codes neutral chroma, not gray only." if params.pixel_format == "gray" else ""
    if params.pixel_format == "gray" and name == "ffv1":
        caps, gray = "format=GRAY8", "" if scene.channels == 1 else CONVERSION
    elif params.pixel_format != "rgb":
        caps += f",{FULL_RANGE}"
    return gstreamer(scene, caps, element, f"out.{_ENDINGS[name]}", sentences(pads, note, gray))


def _rounding_note(params: VideoParams) -> str:
    whole = params.crf is None or params.crf == round(params.crf)
    return "" if whole else f"Its crf is a whole number: {round(params.crf or 0)}."


def _x264(params: VideoParams) -> tuple[str, str]:
    words = ["x264enc", f"speed-preset={params.preset}", f"key-int-max={params.gop}", "threads=1", "aud=false"]
    if params.bitrate_kbps is not None:
        words += [f"bitrate={params.bitrate_kbps:.0f}", f"vbv-buf-capacity={params.vbv_ms:.0f}"]
    elif params.qp is not None:
        words += ["pass=quant", f"quantizer={min(params.qp, 50)}"]
    else:
        words += ["pass=qual", f"quantizer={min(round(params.crf or 0), 50)}", "vbv-buf-capacity=0"]
    words += ["tune=zerolatency"] if params.latency == "low" else ["mb-tree=false", "bframes=3"]
    words += ["intra-refresh=true"] if params.intra_refresh else []
    return " ".join([*words, "option-string=scenecut=0"]), sentences(_rounding_note(params), _OTHER_BUILD)


def _x265(params: VideoParams) -> tuple[str, str]:
    x265_params = params.traits.settings(params)["x265-params"]
    words = ["x265enc", f"speed-preset={params.preset}", f"key-int-max={params.gop}"]
    if params.bitrate_kbps is not None:
        words.append(f"bitrate={params.bitrate_kbps:.0f}")
        buffer = params.bitrate_kbps * params.vbv_ms / 1000
        x265_params += f":vbv-maxrate={params.bitrate_kbps:.0f}:vbv-bufsize={buffer:.0f}"
    elif params.qp is not None:
        words.append(f"qp={params.qp}")
    else:
        x265_params += f":crf={params.crf:g}"
    tune = "" if params.latency == "low" else "x265enc always has a tune, ssim here."
    words.append("tune=zerolatency" if params.latency == "low" else "tune=ssim")
    return " ".join([*words, f"option-string={x265_params}"]), sentences(tune, _OTHER_BUILD)


def _svt_av1(params: VideoParams) -> tuple[str, str]:
    settings = params.traits.settings(params)
    rate = f"target-bitrate={params.bitrate_kbps:.0f}" if params.bitrate_kbps else f"crf={params.crf or 0:.0f}"
    rate = rate if params.qp is None else f"cqp={params.qp}"
    words = ["svtav1enc", f"preset={params.preset}", rate, f"intra-period-length={params.gop - 1}"]
    return " ".join([*words, f"parameters-string={settings['svtav1-params']}"]), f"Not tested. {_SVT}"


def _mjpeg(params: VideoParams) -> tuple[str, str]:
    return f"avenc_mjpeg qmin={params.qp} qmax={params.qp}", ""


def _ffv1(params: VideoParams) -> tuple[str, str]:
    return f"avenc_ffv1 gop-size={params.gop} slices=4 slicecrc=true ! matroskamux", ""


_ELEMENTS: Final = {"libx264": _x264, "libx265": _x265, "libsvtav1": _svt_av1, "mjpeg": _mjpeg, "ffv1": _ffv1}
