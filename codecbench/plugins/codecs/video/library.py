"""Access to PyAV: checks for codecs, and opens encoders and decoders. No other module imports it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Final

import numpy as np

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.image import Image
from codecbench.plugins.codecs.video.encoders import Encoder, VideoParams
from codecbench.plugins.codecs.video.header import Header

if TYPE_CHECKING:
    from av import Packet, VideoCodecContext, VideoFrame
    from av.stream import Stream

_FULL_RANGE: Final = 2
_BT601: Final = 5
_MARGIN: Final = 128  # upper bound of what padding and the blocks of a format add
_RATE_DENOMINATOR: Final = 1001
_WITH_THREADS: Final = 17  # the version of PyAV from which frames are converted by several threads
_SOFTWARE: Final = "encoder: libx264, which needs no hardware"
_REINSTALLING: Final = "run: pip install --upgrade --force-reinstall 'av>=16'; its wheels include the software encoders"
_STRICT: Final = {"err_detect": "crccheck+bitstream+buffer+explode", "ec": "0"}


@cache
def load_av() -> ModuleType:
    """Import PyAV. Raises Unsupported, with the command that installs it, if it is missing."""
    os.environ.setdefault("SVT_LOG", "-1")  # SVT-AV1 bypasses FFmpeg's log; only this silences it
    try:
        import av  # an optional extra
    except ImportError as error:
        raise Unsupported("PyAV is not installed; run: pip install 'codecbench[video]'") from error
    return av


def require(encoder: Encoder) -> None:
    """Raise Unsupported, with a remedy, if this machine lacks the encoder or its decoder."""
    av = load_av()
    for name, mode in ((encoder.name, "w"), (encoder.decoder, "r")):
        try:
            av.Codec(name, mode)
        except ValueError as error:
            remedy = f"its wheels may lack it: set {_SOFTWARE}" if encoder.hardware else _REINSTALLING
            raise Unsupported(
                f"this build of PyAV has no {name}; {remedy}, or build PyAV against an FFmpeg that has it"
            ) from error


def open_encoder(
    params: VideoParams, width: int, height: int, frame_rate_hz: float, bits: int = 8
) -> VideoCodecContext:
    """Open an encoder for frames of this size, of 8 or 16 bits. Raises Unsupported if FFmpeg cannot open it."""
    av, encoder = load_av(), params.traits
    context: VideoCodecContext = av.CodecContext.create(encoder.name, "w")
    rate = frame_rate(frame_rate_hz)
    context.width, context.height = width, height
    context.pix_fmt = encoder.ffmpeg_format(params, bits)
    context.framerate, context.time_base = rate, 1 / rate
    context.color_range, context.colorspace = _FULL_RANGE, _BT601
    context.options = encoder.settings(params)
    try:
        with preserve_scheduling():
            context.open()
    except (av.FFmpegError, ValueError) as error:
        fault = f"{encoder.name} cannot be opened for {width}x{height}"
        if encoder.hardware:  # FFmpeg's message repeats every option and does not name what is missing
            why = getattr(error, "strerror", None) or "refused"
            raise Unsupported(
                f"{fault} ({why}): it needs {encoder.hardware}; if there is none, set {_SOFTWARE}"
            ) from error
        raise Unsupported(f"{fault}: {error}") from error
    return context


@contextmanager
def preserve_scheduling() -> Iterator[None]:
    """Restore the calling thread's scheduling afterwards.

    SVT-AV1 makes the thread real-time if it may (as root); everything that it does and starts afterwards would take the
    processor from the rest of the machine. The encoder's own threads stay real-time: without that SVT-AV1 4.1 can
    deadlock under load.
    """
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, priority)


def open_decoder(encoder: Encoder, header: Header) -> VideoCodecContext:
    """Open a decoder that marks concealed frames and refuses frames much larger than the header's size."""
    av = load_av()
    context: VideoCodecContext = av.CodecContext.create(encoder.decoder, "r")
    flags = av.codec.context.Flags
    context.thread_count = 1
    context.flags |= flags.output_corrupt | (flags.low_delay if header.is_low_delay else 0)
    width, height = encoder.coded_size(header.width, header.height)
    max_pixels = (width + _MARGIN) * (height + _MARGIN)
    context.options = {**_STRICT, "max_pixels": str(max_pixels)}
    if header.extradata:
        context.extradata = header.extradata
        context.width, context.height = width, height
    return context


def frame_rate(frame_rate_hz: float) -> Fraction:
    """Return a frame rate as FFmpeg represents it."""
    return Fraction(frame_rate_hz).limit_denominator(_RATE_DENOMINATOR)


def packet_for(data: bytes, frame: int) -> Packet[Stream]:
    """Make an FFmpeg packet of these bytes; its pts is the number of the frame."""
    packet: Packet[Stream] = load_av().Packet(data)
    packet.pts = frame
    return packet


def video_frame(width: int, height: int, pixel_format: str) -> VideoFrame:
    """Allocate a frame."""
    frame: VideoFrame = load_av().VideoFrame(width, height, pixel_format)
    frame.color_range, frame.colorspace = _FULL_RANGE, _BT601
    return frame


def samples_of_frame(frame: VideoFrame, pixel_format: str) -> Image:
    """Convert a decoded frame to `rgb24` (H, W, 3) or `gray` (H, W), by its own matrix and range.

    As its `to_ndarray(format=...)`, but in the calling thread: a forked process hangs when it frees the threads.
    """
    av = load_av()
    alone = {"threads": 1} if int(av.__version__.partition(".")[0]) >= _WITH_THREADS else {}
    converted = av.video.reformatter.VideoReformatter().reformat(frame, format=pixel_format, **alone)
    return np.ascontiguousarray(converted.to_ndarray())


def decoding_errors() -> tuple[type[Exception], ...]:
    """Exceptions of FFmpeg's decoders. PyAV 19 raises ValueError too, after bytes that no decoder opens with."""
    return load_av().FFmpegError, ValueError


def versions() -> dict[str, str]:
    """Versions of PyAV, whose wheel has the encoders, and of FFmpeg's libavcodec in it."""
    av = load_av()
    return {"av": av.__version__, "libavcodec": ".".join(map(str, av.library_versions["libavcodec"]))}
