"""The one door to PyAV: what it has, and encoders and decoders that are open."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Final

from codecbench.core.contracts.errors import Unsupported
from codecbench.plugins.codecs.video.encoders import Encoder, VideoParams
from codecbench.plugins.codecs.video.header import Header

if TYPE_CHECKING:
    from av import Packet, VideoCodecContext, VideoFrame
    from av.stream import Stream

_FULL_RANGE: Final = 2
_BT601: Final = 5
_MARGIN: Final = 128  # what padding and the blocks of a format add at the most
_RATE_DENOMINATOR: Final = 1001
_SOFTWARE: Final = "encoder: libx264, which needs no hardware"
_REINSTALLING: Final = (
    "run: pip install --upgrade --force-reinstall 'av>=16', whose wheels carry the encoders in software"
)
_STRICT: Final = {"err_detect": "crccheck+bitstream+buffer+explode", "ec": "0"}


@cache
def load_av() -> ModuleType:
    """PyAV. Raises Unsupported with the command that installs it."""
    os.environ.setdefault("SVT_LOG", "-1")  # SVT-AV1 writes past FFmpeg to standard error and listens to this alone
    try:
        import av
    except ImportError as error:
        raise Unsupported("PyAV is not installed; run: pip install 'codecbench[video]'") from error
    return av


def require(encoder: Encoder) -> None:
    """Raise Unsupported, with what to do, where this machine does not have the encoder or its decoder."""
    av = load_av()
    for name, mode in ((encoder.name, "w"), (encoder.decoder, "r")):
        try:
            av.Codec(name, mode)
        except ValueError as error:
            remedy = f"its wheels may lack it: set {_SOFTWARE}" if encoder.hardware else _REINSTALLING
            raise Unsupported(
                f"this build of PyAV has no {name}; {remedy}, or build PyAV against an FFmpeg that has it"
            ) from error


def open_encoder(params: VideoParams, width: int, height: int, frame_rate_hz: float) -> VideoCodecContext:
    """An encoder for pictures of this size. Raises Unsupported where FFmpeg cannot open it."""
    av, encoder = load_av(), params.traits
    context: VideoCodecContext = av.CodecContext.create(encoder.name, "w")
    rate = frame_rate(frame_rate_hz)
    context.width, context.height = width, height
    context.pix_fmt = encoder.ffmpeg_format(params)
    context.framerate, context.time_base = rate, 1 / rate
    context.color_range, context.colorspace = _FULL_RANGE, _BT601
    context.options = encoder.settings(params)
    try:
        with priority_kept():
            context.open()
    except (av.FFmpegError, ValueError) as error:
        what = f"{encoder.name} cannot be opened for {width}x{height}"
        if encoder.hardware:  # FFmpeg's own words, which repeat every option, say less than what is missing
            why = getattr(error, "strerror", None) or "refused"
            raise Unsupported(
                f"{what} ({why}): it needs {encoder.hardware}; if there is none, set {_SOFTWARE}"
            ) from error
        raise Unsupported(f"{what}: {error}") from error
    return context


@contextmanager
def priority_kept() -> Iterator[None]:
    """The calling thread has its scheduling of before.

    SVT-AV1 makes it real-time where it may (as root): whatever it does and starts from then on would take the processor
    from everything else on the machine. The encoder's own threads stay so: under load, SVT-AV1 4.1 can wait for itself
    for ever where they are not.
    """
    policy, priority = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, priority)


def open_decoder(encoder: Encoder, header: Header) -> VideoCodecContext:
    """A decoder that conceals nothing unsaid and takes no picture much larger than the header tells."""
    av = load_av()
    context: VideoCodecContext = av.CodecContext.create(encoder.decoder, "r")
    flags = av.codec.context.Flags
    context.thread_count = 1
    context.flags |= flags.output_corrupt | (flags.low_delay if header.is_low_delay else 0)
    width, height = encoder.coded_size(header.width, header.height)
    most_pixels = (width + _MARGIN) * (height + _MARGIN)
    context.options = {**_STRICT, "max_pixels": str(most_pixels)}
    if header.extradata:
        context.extradata = header.extradata
        context.width, context.height = width, height
    return context


def frame_rate(frame_rate_hz: float) -> Fraction:
    """A frame rate as FFmpeg has it."""
    return Fraction(frame_rate_hz).limit_denominator(_RATE_DENOMINATOR)


def packet_for(data: bytes, frame: int) -> Packet[Stream]:
    """A packet of FFmpeg's with these bytes, whose picture will be known by its number."""
    packet: Packet[Stream] = load_av().Packet(data)
    packet.pts = frame
    return packet


def video_frame(width: int, height: int, pixel_format: str) -> VideoFrame:
    """A frame to be filled."""
    frame: VideoFrame = load_av().VideoFrame(width, height, pixel_format)
    frame.color_range, frame.colorspace = _FULL_RANGE, _BT601
    return frame


def decoding_errors() -> tuple[type[Exception], ...]:
    """What FFmpeg's decoders raise: PyAV 19 a ValueError too, after bytes with which a decoder could not be opened."""
    return load_av().FFmpegError, ValueError


def versions() -> dict[str, str]:
    """PyAV, whose wheel decides which encoders these are, and FFmpeg's codecs in it."""
    av = load_av()
    return {"av": av.__version__, "libavcodec": ".".join(map(str, av.library_versions["libavcodec"]))}
