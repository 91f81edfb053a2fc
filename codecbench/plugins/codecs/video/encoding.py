"""A sequence being encoded by one of FFmpeg's encoders."""

from __future__ import annotations

from typing import Any

from codecbench.core.contracts.errors import ImageError
from codecbench.core.contracts.image import MAX_PIXELS, Image, channel_count, check_image
from codecbench.core.contracts.stream import Packet, StreamEncoder
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.video.colour import fill_frame, padded, planes_from_image
from codecbench.plugins.codecs.video.header import MAX_SIDE, Header, frames_to_recovery
from codecbench.plugins.codecs.video.library import open_encoder, video_frame
from codecbench.plugins.codecs.video.params import VideoParams


class VideoEncoder(StreamEncoder):
    """An encoder is opened for the first picture, whose shape the others share.

    One that looks ahead in threads of its own gives all packets at the end, so that equal pictures give equal sessions.

    magic: four bytes that name the codec. sends_extradata: whether the decoder needs a header that the encoder keeps
    apart from its packets.
    """

    def __init__(self, params: VideoParams, magic: bytes, frame_rate_hz: float, *, sends_extradata: bool) -> None:
        self._params, self._magic, self._frame_rate_hz = params, magic, frame_rate_hz
        self._sends_extradata = sends_extradata
        self._context: Any = None
        self._shape: tuple[int, ...] = ()
        self._size = (0, 0)
        self._header = b""
        self._pushed = 0
        self._keeps_all = params.latency == "any" and params.traits.asynchronous
        self._kept: list[Packet] = []

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        image = check_image(image)
        if self._context is None:
            self._open(image)
        elif image.shape != self._shape:
            raise ImageError(f"a picture of shape {image.shape} in a stream of shape {self._shape}")
        params = self._params
        frame = video_frame(*self._size, params.traits.ffmpeg_format(params))
        fill_frame(frame, planes_from_image(padded(image, *self._size), params.pixel_format))
        frame.pts = self._pushed
        self._pushed += 1
        packets = self._packets(frame)
        if not self._keeps_all:
            return packets
        self._kept += packets
        return []

    def flush(self) -> list[Packet]:
        return [] if self._context is None else self._kept + self._packets(None)

    def _open(self, image: Image) -> None:
        height, width = image.shape[:2]
        if max(height, width) > MAX_SIDE or height * width > MAX_PIXELS:
            raise ImageError(f"{width}x{height} exceeds {MAX_SIDE} a side or {MAX_PIXELS} pixels")
        params = self._params
        self._size = params.traits.coded_size(width, height)
        self._context = open_encoder(params, *self._size, self._frame_rate_hz)
        self._shape = image.shape
        extradata = self._context.extradata if self._sends_extradata else b""
        is_low_delay = params.latency == "low"
        self._header = Header(
            self._magic, width, height, channel_count(image), is_low_delay, extradata or b""
        ).to_bytes()

    def _packets(self, frame: Any) -> list[Packet]:
        found: list[Packet] = []
        for packet in self._context.encode(frame):
            data, number = bytes(packet), int(packet.pts)
            if packet.is_keyframe:  # with intra refresh also where a refresh begins, at which no picture is whole yet
                data = self._header + data
            refreshes = bool(packet.is_keyframe and self._params.intra_refresh and number)
            recovery = frames_to_recovery(data) if refreshes else None
            found.append(Packet(data, number, packet.is_keyframe and not refreshes, recovery))
        return found
