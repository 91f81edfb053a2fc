"""A video codec: deflated differences between frames, and a keyframe every `gop`."""

import struct
import zlib

import numpy as np
from pydantic import Field

from codecbench import (
    NULL_TRACE,
    BitstreamError,
    Capabilities,
    Image,
    ImageError,
    Loss,
    Packet,
    Params,
    Picture,
    StreamCodec,
    StreamDecoder,
    StreamEncoder,
    Trace,
    check_image,
)

_HEADER = struct.Struct("<4s?HHB")  # magic, keyframe, height, width, channels
_CRC_BYTES = 4
_MAX_SIDE = 0xFFFF
_MAX_SAMPLES = 1 << 27


class DeltaParams(Params):
    gop: int = Field(default=12, ge=1, description="pictures from one whole picture to the next")
    hold: int = Field(default=0, ge=0, le=100, description="pictures that the encoder holds back")


class Delta(StreamCodec[DeltaParams]):
    name = "delta"
    version = "1"
    params_type = DeltaParams
    capabilities = Capabilities(lossless=True)
    examples = ({}, {"gop": 1}, {"hold": 3})

    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return DeltaEncoder(self.params)

    def decoder(self) -> StreamDecoder:
        return DeltaDecoder()

    def is_low_delay(self) -> bool:
        return self.params.hold == 0


class DeltaEncoder(StreamEncoder):
    def __init__(self, params: DeltaParams) -> None:
        self.params = params
        self.last: Image | None = None
        self.pushed = 0
        self.held: list[Packet] = []

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        image = check_image(image)
        if max(image.shape[:2]) > _MAX_SIDE or image.size > _MAX_SAMPLES:
            raise ImageError(f"delta: shape {image.shape} exceeds {_MAX_SIDE} a side or {_MAX_SAMPLES} samples")
        if self.last is not None and image.shape != self.last.shape:
            raise ImageError(f"delta: shape {image.shape} after {self.last.shape}; a stream has one")
        starts = self.pushed % self.params.gop == 0
        change = image if starts or self.last is None else image - self.last  # modulo 256
        header = _HEADER.pack(b"DLTA", starts, *image.shape[:2], 1 if image.ndim == 2 else 3)
        content = header + zlib.compress(change.tobytes())
        self.held.append(Packet(content + _crc(content), self.pushed, starts))
        self.last, self.pushed = image.copy(), self.pushed + 1
        return self._released(self.params.hold)

    def flush(self) -> list[Packet]:
        return self._released(0)

    def _released(self, left: int) -> list[Packet]:
        count = max(0, len(self.held) - left)
        ready, self.held = self.held[:count], self.held[count:]
        return ready


class DeltaDecoder(StreamDecoder):
    def __init__(self) -> None:
        self.last: Image | None = None
        self.is_whole = False
        self.next = 0

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        frame = self.next if isinstance(packet, Loss) else packet.frame
        gap, self.next = frame != self.next, frame + 1
        if isinstance(packet, Loss) or gap:
            self.is_whole = False
        if not isinstance(packet, Loss):
            self._take(packet.data)
        if self.last is None:
            return [Picture(frame, "missing", None)]
        return [Picture(frame, "whole" if self.is_whole else "concealed", self.last.copy())]

    def flush(self) -> list[Picture]:
        return []

    def _take(self, data: bytes) -> None:
        """Decode a packet if nothing that it needs is lost; else repeat the last frame."""
        whole, self.is_whole = self.is_whole, False
        starts, change = _read(data)
        if starts:
            self.last, self.is_whole = change, True
        elif whole and self.last is not None and change.shape == self.last.shape:
            self.last, self.is_whole = self.last + change, True


def _read(data: bytes) -> tuple[bool, Image]:
    """Return whether a packet is a keyframe, and its samples."""
    content = data[:-_CRC_BYTES]
    if len(content) < _HEADER.size or content[:4] != b"DLTA" or data[-_CRC_BYTES:] != _crc(content):
        raise BitstreamError("delta: damaged, truncated or foreign")
    _, starts, height, width, channels = _HEADER.unpack_from(content)
    size = height * width * channels
    if channels not in (1, 3) or not 0 < size <= _MAX_SAMPLES:
        raise BitstreamError(f"delta: {width}x{height}x{channels} is not allowed")
    inflate = zlib.decompressobj()
    try:
        samples = inflate.decompress(content[_HEADER.size :], size + 1)
    except zlib.error as error:
        raise BitstreamError(f"delta: {error}") from None
    if len(samples) != size or not inflate.eof or inflate.unused_data:
        raise BitstreamError(f"delta: the content is not {size} samples")
    shape = (height, width, 3) if channels == 3 else (height, width)
    return starts, np.frombuffer(samples, np.uint8).reshape(shape)


def _crc(content: bytes) -> bytes:
    return zlib.crc32(content).to_bytes(_CRC_BYTES, "little")
