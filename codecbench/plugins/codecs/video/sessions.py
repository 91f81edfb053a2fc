"""A stream being decoded by one of FFmpeg's decoders, which says of each picture whether it is what was sent.

A picture is whole if every packet since the last start came and was decoded, for no other can it refer to; or if it
follows an exact recovery point. FFmpeg's own marks of damage are believed on top of that. After a loss the next start
is decoded by a new decoder, so that nothing of the damage is left.
"""

from __future__ import annotations

from typing import Any

from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import MAX_PIXELS, Image, channel_count, check_image
from codecbench.core.contracts.stream import Loss, Packet, Picture, PictureState, StreamDecoder, StreamEncoder
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.video.color import fill_frame, image_from_frame, padded, planes_from_image
from codecbench.plugins.codecs.video.encoders import Encoder, VideoParams
from codecbench.plugins.codecs.video.header import MAX_SIDE, Header, frames_to_recovery
from codecbench.plugins.codecs.video.library import decoding_errors, open_decoder, open_encoder, packet_for, video_frame


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


class VideoDecoder(StreamDecoder):
    """Pictures leave in the order in which they are shown, numbered without gaps.

    encoder: what wrote the stream. magic: four bytes that name the codec.
    """

    def __init__(self, encoder: Encoder, magic: bytes) -> None:
        self._encoder, self._magic = encoder, magic
        self._context: Any = None
        self._header: Header | None = None
        self._is_intact = False
        self._lost_since_start = False
        self._whole_from: int | None = None
        self._states: dict[int, PictureState] = {}
        self._next = 0
        self._arrived = 0

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        self._arrived += 1
        if isinstance(packet, Loss):
            self._lose()
            return self._missing_before(self._next + 1) if self._answers_at_once else []
        pictures = self._resumed_at(packet) if packet.starts and not self._is_intact else []
        try:
            data = self._content(packet)
        except BitstreamError:
            self._give_up(packet.frame)
            raise
        return pictures + self._pictures(packet.frame, data)

    def flush(self) -> list[Picture]:
        pictures = self._in_order(self._drained())
        return pictures + self._missing_before(self._arrived)

    @property
    def _answers_at_once(self) -> bool:
        """Whether each packet gives its picture: always before a start, when all that there is to say is `missing`."""
        return self._context is None or self._header is None or self._header.is_low_delay

    def _lose(self) -> None:
        self._is_intact, self._lost_since_start, self._whole_from = False, True, None

    def _resumed_at(self, start: Packet) -> list[Picture]:
        """Take leave of a damaged decoder: what it still holds, and what is missing up to the start."""
        pictures = self._in_order(self._drained())
        self._context, self._states = None, {}
        return pictures + self._missing_before(start.frame)

    def _content(self, packet: Packet) -> bytes:
        """The encoder's part of a packet; opens the decoder where one can begin."""
        if not packet.starts and not (self._encoder.recovers and packet.data.startswith(self._magic)):
            return packet.data
        header, data = Header.taken_from(packet.data, self._magic)
        if self._context is None or (packet.starts and header != self._header):
            self._context, self._header = open_decoder(self._encoder, header), header
        if packet.starts:
            self._is_intact, self._lost_since_start = True, False
        elif not self._is_intact and self._whole_from is None and (frames := frames_to_recovery(data)) is not None:
            self._whole_from = packet.frame + frames
        return data

    def _pictures(self, frame: int, data: bytes) -> list[Picture]:
        """What comes of a packet's bytes. Raises BitstreamError where they should have given a picture."""
        if self._context is None:
            return self._missing_before(frame + 1)
        if self._whole_from is not None and frame >= self._whole_from:
            self._is_intact, self._whole_from = True, None
        self._states[frame] = "whole" if self._is_intact else "concealed"
        try:
            decoded = self._context.decode(packet_for(data, frame))
            if not decoded and self._lost_since_start and self._encoder.recovers and self._answers_at_once:
                self._context.flush_buffers()  # a lost frame number that wraps round has it take this for long shown
                decoded = self._context.decode(packet_for(data, frame))
            pictures = self._in_order(decoded)
        except decoding_errors() as error:
            decoded, pictures = [], []
            if not self._context.is_open:  # what the header says of the stream was refused, and FFmpeg tries once
                self._context = None
            if self._is_intact:
                self._give_up(frame)
                raise BitstreamError(f"the packet of frame {frame} cannot be decoded: {error}") from error
        if not self._answers_at_once or self._next > frame:
            return pictures
        if not self._lost_since_start:
            self._give_up(frame)
            raise BitstreamError(f"the packet of frame {frame} gives no picture")
        return pictures + self._missing_before(frame + 1)

    def _give_up(self, frame: int) -> None:
        """After bytes that were refused: the error has told of the picture where pictures come at once."""
        self._lose()
        if self._answers_at_once:
            self._next = max(self._next, frame + 1)

    def _drained(self) -> list[Any]:
        try:
            return [] if self._context is None else list(self._context.decode(None))
        except decoding_errors():
            return []

    def _in_order(self, frames: list[Any]) -> list[Picture]:
        """Decoded frames as pictures, each behind those that never came; doubles and strangers are left out."""
        pictures: list[Picture] = []
        for frame in frames:
            number = frame.pts
            if number is None or number < self._next or number not in self._states:
                continue
            pictures += self._missing_before(number)
            state, image = self._states.pop(number), self._image(frame)
            state = "concealed" if frame.is_corrupt else state
            pictures.append(Picture(number, "missing" if image is None else state, image))
            self._next = number + 1
        return pictures

    def _missing_before(self, frame: int) -> list[Picture]:
        missing = [Picture(number, "missing", None) for number in range(self._next, frame)]
        self._next = max(self._next, frame)
        self._states = {number: state for number, state in self._states.items() if number >= self._next}
        return missing

    def _image(self, frame: Any) -> Image | None:
        """The picture without padding, or None where the frame is not of the size that the header tells."""
        header = self._header
        assert header is not None
        if (frame.width, frame.height) != self._encoder.coded_size(header.width, header.height):
            return None
        image = image_from_frame(frame, header.channels)
        return None if image is None else image[: header.height, : header.width].copy()
