"""Encoding and decoding sessions with FFmpeg; the decoder classifies each frame as whole, concealed or missing.

A frame is whole if every packet since the last keyframe was received and decoded, or if it follows an exact recovery
point; FFmpeg's own marks of damage override that. After a loss the next keyframe is decoded by a new decoder, so that
no damage remains.
"""

from __future__ import annotations

from typing import Any

from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import MAX_PIXELS, Image, check_image, layout_of
from codecbench.core.contracts.stream import Loss, Packet, Picture, PictureState, StreamDecoder, StreamEncoder
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.video.color import (
    codes_from_frame,
    fill_frame,
    image_from_frame,
    pad_image,
    planes_from_codes,
    planes_from_image,
)
from codecbench.plugins.codecs.video.encoders import Encoder, VideoParams
from codecbench.plugins.codecs.video.header import MAX_SIDE, Header, check_slices, frames_to_recovery
from codecbench.plugins.codecs.video.library import decoding_errors, open_decoder, open_encoder, packet_for, video_frame


class VideoEncoder(StreamEncoder):
    """An encoding session. The encoder is opened for the first image; the others must have its shape and bits.

    An encoder that looks ahead in its own threads returns all packets at the end, so that sessions are reproducible.

    magic: four bytes that identify the codec. sends_extradata: whether the decoder needs a header that the encoder does
    not write into its packets.
    """

    def __init__(self, params: VideoParams, magic: bytes, frame_rate_hz: float, *, sends_extradata: bool) -> None:
        self._params, self._magic, self._frame_rate_hz = params, magic, frame_rate_hz
        self._sends_extradata = sends_extradata
        self._context: Any = None
        self._shape: tuple[int, ...] = ()
        self._bits = 8
        self._size = (0, 0)
        self._header = b""
        self._pushed = 0
        self._delays_packets = params.latency == "any" and params.traits.asynchronous
        self._delayed: list[Packet] = []

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        image = check_image(image, bits=(8,) if self._params.depth is None else (8, 16))
        if self._context is None:
            self._open(image)
        elif layout_of(image).bits != self._bits:
            raise ImageError(f"a frame of {layout_of(image).bits} bits in a stream of {self._bits} bits")
        elif image.shape != self._shape:
            raise ImageError(f"a frame of shape {image.shape} in a stream of shape {self._shape}")
        params = self._params
        frame = video_frame(*self._size, params.traits.ffmpeg_format(params, self._bits))
        fill_frame(frame, self._planes(pad_image(image, *self._size), frame.format.name))
        frame.pts = self._pushed
        self._pushed += 1
        packets = self._packets(frame)
        if not self._delays_packets:
            return packets
        self._delayed += packets
        return []

    def flush(self) -> list[Packet]:
        return [] if self._context is None else self._delayed + self._packets(None)

    def _planes(self, image: Image, ffmpeg_format: str) -> list[Image]:
        depth = self._params.depth
        if self._bits == 16 and depth is not None:
            return planes_from_codes(depth.codes(image), depth.depth_bits, ffmpeg_format)
        return planes_from_image(image, self._params.pixel_format)

    def _open(self, image: Image) -> None:
        height, width = image.shape[:2]
        if max(height, width) > MAX_SIDE or height * width > MAX_PIXELS:
            raise ImageError(f"{width}x{height} exceeds {MAX_SIDE} a side or {MAX_PIXELS} pixels")
        params = self._params
        self._size = params.traits.coded_size(width, height)
        channels, self._bits = layout_of(image)
        self._context = open_encoder(params, *self._size, self._frame_rate_hz, self._bits)
        self._shape = image.shape
        extradata = self._context.extradata if self._sends_extradata else b""
        is_low_delay = params.latency == "low"
        depth = params.depth.depth_scale if self._bits == 16 and params.depth is not None else None
        self._header = Header(self._magic, width, height, channels, is_low_delay, extradata or b"", depth).to_bytes()

    def _packets(self, frame: Any) -> list[Packet]:
        packets: list[Packet] = []
        for packet in self._context.encode(frame):
            data, number = bytes(packet), int(packet.pts)
            if packet.is_keyframe:  # with intra refresh also at the start of a refresh, when no frame is whole yet
                data = self._header + data
            refreshes = bool(packet.is_keyframe and self._params.intra_refresh and number)
            recovery = frames_to_recovery(data) if refreshes else None
            packets.append(Packet(data, number, packet.is_keyframe and not refreshes, recovery))
        return packets


class VideoDecoder(StreamDecoder):
    """A decoding session. Frames leave in presentation order, numbered without gaps.

    encoder: the stream's encoder. magic: four bytes that identify the codec.
    """

    def __init__(self, encoder: Encoder, magic: bytes) -> None:
        self._encoder, self._magic = encoder, magic
        self._context: Any = None
        self._header: Header | None = None
        self._is_intact = False
        self._lost_since_keyframe = False
        self._recovery_frame: int | None = None
        self._states: dict[int, PictureState] = {}
        self._next = 0
        self._arrived = 0

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        self._arrived += 1
        if isinstance(packet, Loss):
            self._lose()
            return self._missing_pictures(self._next + 1) if self._is_immediate else []
        pictures = self._close_before(packet) if packet.starts and not self._is_intact else []
        try:
            data = self._payload(packet)
            if self._encoder.slices:
                check_slices(data, self._encoder.slices)
        except BitstreamError:
            self._give_up(packet.frame)
            raise
        return pictures + self._decode(packet.frame, data)

    def flush(self) -> list[Picture]:
        pictures = self._ordered_pictures(self._drain())
        return pictures + self._missing_pictures(self._arrived)

    @property
    def _is_immediate(self) -> bool:
        """Whether each packet gives its frame at once; before a keyframe it does, as `missing`."""
        return self._context is None or self._header is None or self._header.is_low_delay

    def _lose(self) -> None:
        self._is_intact, self._lost_since_keyframe, self._recovery_frame = False, True, None

    def _close_before(self, start: Packet) -> list[Picture]:
        """Close a damaged decoder; returns its remaining frames and the missing ones up to the keyframe."""
        pictures = self._ordered_pictures(self._drain())
        self._context, self._states = None, {}
        return pictures + self._missing_pictures(start.frame)

    def _payload(self, packet: Packet) -> bytes:
        """Return the encoder's part of a packet; opens the decoder if decoding can begin there."""
        if not packet.starts and not (self._encoder.recovers and packet.data.startswith(self._magic)):
            return packet.data
        header, data = Header.parse(packet.data, self._magic)
        if self._context is None or (packet.starts and header != self._header):
            self._context, self._header = open_decoder(self._encoder, header), header
        if packet.starts:
            self._is_intact, self._lost_since_keyframe = True, False
        elif not self._is_intact and self._recovery_frame is None and (frames := frames_to_recovery(data)) is not None:
            self._recovery_frame = packet.frame + frames
        return data

    def _decode(self, frame: int, data: bytes) -> list[Picture]:
        """Decode a packet's bytes. Raises BitstreamError if they should have given a frame and did not."""
        if self._context is None:
            return self._missing_pictures(frame + 1)
        if self._recovery_frame is not None and frame >= self._recovery_frame:
            self._is_intact, self._recovery_frame = True, None
        self._states[frame] = "whole" if self._is_intact else "concealed"
        try:
            decoded = self._context.decode(packet_for(data, frame))
            if not decoded and self._lost_since_keyframe and self._encoder.recovers and self._is_immediate:
                self._context.flush_buffers()  # else a wrapped frame number passes for one already shown
                decoded = self._context.decode(packet_for(data, frame))
            pictures = self._ordered_pictures(decoded)
        except decoding_errors() as error:
            decoded, pictures = [], []
            if not self._context.is_open:  # FFmpeg refused the extradata and does not try again
                self._context = None
            if self._is_intact:
                self._give_up(frame)
                raise BitstreamError(f"the packet of frame {frame} cannot be decoded: {error}") from error
        if not self._is_immediate or self._next > frame:
            return pictures
        if not self._lost_since_keyframe:
            self._give_up(frame)
            raise BitstreamError(f"the packet of frame {frame} decodes to no frame")
        return pictures + self._missing_pictures(frame + 1)

    def _give_up(self, frame: int) -> None:
        """Handle refused bytes; if frames come at once, the error stands for the frame."""
        self._lose()
        if self._is_immediate:
            self._next = max(self._next, frame + 1)

    def _drain(self) -> list[Any]:
        try:
            return [] if self._context is None else list(self._context.decode(None))
        except decoding_errors():
            return []

    def _ordered_pictures(self, frames: list[Any]) -> list[Picture]:
        """Convert decoded frames to pictures and insert the missing ones; duplicates and unknown frames are dropped."""
        pictures: list[Picture] = []
        for frame in frames:
            number = frame.pts
            if number is None or number < self._next or number not in self._states:
                continue
            pictures += self._missing_pictures(number)
            state, image = self._states.pop(number), self._image(frame)
            state = "concealed" if frame.is_corrupt else state
            pictures.append(Picture(number, "missing" if image is None else state, image))
            self._next = number + 1
        return pictures

    def _missing_pictures(self, frame: int) -> list[Picture]:
        missing = [Picture(number, "missing", None) for number in range(self._next, frame)]
        self._next = max(self._next, frame)
        self._states = {number: state for number, state in self._states.items() if number >= self._next}
        return missing

    def _image(self, frame: Any) -> Image | None:
        """Convert a frame to an image without padding; None if its size is not the header's."""
        header = self._header
        assert header is not None
        if (frame.width, frame.height) != self._encoder.coded_size(header.width, header.height):
            return None
        if header.depth is not None:
            codes = codes_from_frame(frame, header.depth.bits)
            return None if codes is None else header.depth.pixels(codes[: header.height, : header.width]).copy()
        image = image_from_frame(frame, header.channels)
        return None if image is None else image[: header.height, : header.width].copy()
