"""Write packets to a video file that any player reads, without re-encoding."""

from __future__ import annotations

import io
import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

from codecbench.core.contracts.errors import ParamsError
from codecbench.core.contracts.stream import Packet
from codecbench.plugins.codecs.video.codecs import VideoCodec
from codecbench.plugins.codecs.video.encoders import Encoder
from codecbench.plugins.codecs.video.header import Header
from codecbench.plugins.codecs.video.library import frame_rate, load_av, open_encoder, packet_for

_CONTAINERS: Final = {
    ".mp4": "mp4", ".mkv": "matroska", ".h264": "h264", ".hevc": "hevc", ".h265": "hevc", ".ivf": "ivf", ".obu": "obu",
    ".mjpeg": "mjpeg",
}  # fmt: skip
_ELEMENTARY: Final = {"h264": "h264", "hevc": "hevc", "libdav1d": "obu", "vp9": "ivf", "mjpeg": "mjpeg"}
_IVF_FILE: Final = struct.Struct("<4sHH4sHHIIII")
_IVF_FRAME: Final = struct.Struct("<IQ")


def file_from_packets(codec: VideoCodec[Any], packets: Sequence[Packet], frame_rate_hz: float, name: str) -> bytes:
    """Return the content of a video file; the ending of `name` selects the container.

    The encoder's bytes are copied, without our header. packets: in sending order, the first a keyframe. Raises
    ParamsError if the ending is unknown or its container does not support the codec.
    """
    suffix = Path(name).suffix.lower()
    if suffix not in _CONTAINERS:
        raise ParamsError(f"{name}: {suffix or 'no ending'} is not one of {', '.join(_CONTAINERS)}")
    header, _ = Header.parse(packets[0].data, codec.magic)
    payloads = [payload(packet.data, codec.magic) for packet in packets]
    buffer = io.BytesIO()
    av = load_av()
    with av.open(buffer, "w", format=_CONTAINERS[suffix]) as container:
        try:
            stream = _add_stream(container, codec, header, payloads[0], frame_rate_hz)
            _mux(container, stream, packets, payloads, frame_rate_hz)
        except (av.FFmpegError, ValueError) as error:
            raise ParamsError(f"{name}: {suffix} does not support {codec.name}: {error}") from error
    return buffer.getvalue()


def payload(data: bytes, magic: bytes) -> bytes:
    """Return the encoder's bytes of a packet, without our header if it has one. magic: of the codec; empty for none."""
    return Header.parse(data, magic)[1] if magic and data.startswith(magic) else data


def _add_stream(container: Any, codec: VideoCodec[Any], header: Header, first: bytes, frame_rate_hz: float) -> Any:
    """Add a stream to the container with the parameters that FFmpeg reads from the first packet.

    FFV1's packets do not contain them; they are taken from an encoder with the same parameters.
    """
    traits: Encoder = codec.params.traits
    size = traits.coded_size(header.width, header.height)
    if header.extradata:
        opened = open_encoder(codec.params, *size, frame_rate_hz, bits=8 if header.depth is None else 16)
        stream = container.add_stream(traits.name, rate=frame_rate(frame_rate_hz), options=opened.options)
        stream.width, stream.height = size
        stream.pix_fmt = opened.pix_fmt
        container.start_encoding()
        return stream
    elementary = _ELEMENTARY[traits.decoder]
    content = _ivf(first, size, frame_rate(frame_rate_hz)) if elementary == "ivf" else first
    with load_av().open(io.BytesIO(content), format=elementary) as source:
        return container.add_stream_from_template(source.streams.video[0], opaque=True)


def _ivf(packet: bytes, size: tuple[int, int], rate: Fraction) -> bytes:
    """Make a file of one VP9 packet."""
    return (
        _IVF_FILE.pack(b"DKIF", 0, _IVF_FILE.size, b"VP90", *size, rate.numerator, rate.denominator, 1, 0)
        + _IVF_FRAME.pack(len(packet), 0)
        + packet
    )


def _mux(
    container: Any, stream: Any, packets: Sequence[Packet], payloads: Sequence[bytes], frame_rate_hz: float
) -> None:
    """Mux packets: decoding order is the packets', presentation order that of their frames, the first at 0.

    If frames are reordered, decoding begins before 0, as with FFmpeg's encoders. A muxer adapts that to its container:
    MP4's writes an edit list.
    """
    reorder_delay = max(place - packet.frame for place, packet in enumerate(packets))
    interval_s: Fraction = 1 / frame_rate(frame_rate_hz)
    for place, (packet, payload) in enumerate(zip(packets, payloads, strict=True)):
        muxed = packet_for(payload, packet.frame)
        muxed.dts, muxed.duration = place - reorder_delay, 1
        muxed.time_base, muxed.stream = interval_s, stream
        muxed.is_keyframe = packet.starts
        container.mux(muxed)
