"""Decoding a stream: packets are pushed into a session in order, and pictures are found again by frame."""

from __future__ import annotations

import random
import zlib
from bisect import bisect_right
from collections.abc import Callable, Container, Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.stream import Packet, Picture
from codecbench.core.engine.hosting.host import PluginLoss
from codecbench.core.engine.running.coding.position import CodingError, WorkPosition

_TOGETHER: Final = range(4, 9)
_TOGETHER_BYTES: Final = 4 << 20
_CHECKED: Final = 4
KEPT_BYTES: Final = 64 << 20
"""Of decoded pictures that are kept for who looks back a little: 72 colour frames of 640x480."""


def batch_size(size_bytes: int) -> int:
    """How many frames of this size go to a host, or come, at once: to wait for each would take longer, and pages of
    memory that nobody has used before do for many."""
    return min(max(_TOGETHER_BYTES // size_bytes, _TOGETHER.start), _TOGETHER.stop - 1)


def map_until_failure(codec: AnyCodec[Any], verb: str, given: list[Any]) -> list[Any]:
    """What `encode` gives of single images, or `decode` of bitstreams, up to the first that fails; for the process that
    does it, because to hand over each alone can take as long as to code it."""
    found: list[Any] = []
    with suppress(BaseException):  # the call that shows what is wrong comes after
        found.extend(map(getattr(codec, verb), given))
    return found


class StreamPictures:
    """The pictures of a stream by frame, in any order.

    Who asks in order has each packet decoded once, because the session stays open. For who jumps, decoding starts again
    at the last packet at which it can. The pictures that were decoded last are kept, up to `kept_bytes`.
    packets: in the order in which they were sent. read: the bytes of a frame's packet. shared: pictures of this stream
    that were decoded before, by frame; it gets those that are decoded now.
    """

    def __init__(
        self,
        codec: AnyCodec[Any],
        packets: Sequence[SentPacket],
        read: Callable[[int], bytes],
        position: WorkPosition,
        kept_bytes: int = KEPT_BYTES,
        shared: SharedPictures | None = None,
    ) -> None:
        self._codec, self._packets, self._read, self._position = codec, packets, read, position
        self._places = {packet.frame: place for place, packet in enumerate(packets)}
        self._starts = [place for place, packet in enumerate(packets) if packet.starts]
        self._kept: dict[int, Image] = {}
        self._room_bytes = kept_bytes
        self._shared = SharedPictures(0) if shared is None else shared
        self._decoder: CheckedDecoder | None = None
        self._opened = self._next = 0

    def picture(self, frame: int, original: Image) -> Image:
        """The picture of a frame, which the caller may change.

        Raises CodingError where the codec gives none, or one that is not whole or not of the original's shape.
        """
        kept = self._kept.get(frame)
        if kept is None:
            kept = self._shared.get(frame)
        return (self._decoded(frame, original) if kept is None else kept).copy()

    def _decoded(self, frame: int, original: Image) -> Image:
        decoder = self._ready_for(frame)
        self._decoder = None  # one that raises is not used again
        while self._next < len(self._packets):
            sent = self._packets[self._next]
            self._next += 1
            self._position.at("decode", sent.frame)
            pictures = decoder.push(sent.packet(self._read(sent.frame)), original)
            self._keep(pictures)
            if frame in pictures:
                self._decoder = decoder
                return pictures[frame]
        self._position.at("decode", frame)
        pictures = decoder.flush(original)
        self._keep(pictures)
        if frame not in pictures:
            raise CodingError("all packets and flush gave no picture of this frame")
        return pictures[frame]

    def _ready_for(self, frame: int) -> CheckedDecoder:
        """The open session where it comes to this frame, or else a new one."""
        start = self._start_of(frame)
        decoder = self._decoder
        if decoder is not None and frame not in decoder.given and self._opened <= start <= self._next:
            return decoder
        self._opened = self._next = start
        owed = {packet.frame for packet in self._packets[start:] if self._start_of(packet.frame) >= start}
        return CheckedDecoder(self._codec, owed)

    def _start_of(self, frame: int) -> int:
        """The place of the last packet at which decoding can start to have this frame.

        Where encoders reorder, frames before the one that starts may follow it, and need what was sent earlier.
        """
        at = bisect_right(self._starts, self._places[frame]) - 1
        while at > 0 and self._packets[self._starts[at]].frame > frame:
            at -= 1
        return self._starts[at]

    def _keep(self, pictures: Mapping[int, Image]) -> None:
        for frame, image in pictures.items():
            self._kept[frame] = image
            self._shared.keep(frame, image)
            self._room_bytes -= image.nbytes
        while self._room_bytes < 0:
            self._room_bytes += self._kept.pop(next(iter(self._kept))).nbytes


class SharedPictures:
    """Pictures of the stream that this process decoded last, so that its next evaluator need not decode them again.

    A stream is read front to back again and again, so what does not fit into `limit_bytes` is not kept.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._used_bytes = 0
        self._stream = b""
        self._pictures: dict[int, Image] = {}

    def of(self, stream: bytes, limit_bytes: int) -> SharedPictures:
        """This, emptied where it held pictures of a stream of another digest."""
        if stream != self._stream:
            self._stream, self._used_bytes = stream, 0
            self._pictures.clear()
        self._limit_bytes = limit_bytes
        return self

    def get(self, frame: int) -> Image | None:
        return self._pictures.get(frame)

    def keep(self, frame: int, image: Image) -> None:
        if frame not in self._pictures and self._used_bytes + image.nbytes <= self._limit_bytes:
            self._pictures[frame] = image
            self._used_bytes += image.nbytes


class ShuffledPictures:
    """Pictures of a codec of others that codes each on its own, decoded in an order that it cannot foretell.

    Frames are decoded before they are asked for, some neighbors together; an error is raised when its frame is asked
    for. read: the bytes of a frame.
    """

    def __init__(self, codec: AnyCodec[Any], read: Callable[[int], bytes], frames: int, position: WorkPosition) -> None:
        self._codec, self._read, self._frames, self._position = codec, read, frames, position
        self._ready: dict[int, Any] = {}
        self._asked: set[int] = set()
        self._chosen: list[tuple[int, int]] = []
        """Frames that were asked for, with digests of their pictures, to be decoded once more in the end."""
        self._chance = random.SystemRandom()

    def picture(self, frame: int, original: Image) -> Image:
        """The picture of a frame. Raises CodingError for what is no image of the original's shape."""
        if frame not in self._ready:
            if frame in self._asked:  # who looks back does not lose what lies ahead
                self._decode([frame])
            else:
                self._ready = {}
                self._decode(self._around(frame, original.nbytes))
        found = self._ready.pop(frame)
        self._position.at("decode", frame)
        if isinstance(found, BaseException):
            raise found
        image = check_decoding(found, original)
        if frame not in self._asked:
            self._asked.add(frame)
            place = len(self._chosen) if len(self._chosen) < _CHECKED else self._chance.randrange(len(self._asked))
            if place < _CHECKED:  # each of the frames so far is as likely to be among the chosen
                self._chosen[place:] = [(frame, zlib.crc32(image.data)), *self._chosen[place + 1 :]]
        return image

    def check(self, alone: Callable[[], AnyCodec[Any]]) -> None:
        """Raise CodingError where some of the pictures are others when `alone`, in a process of its own, decodes them.

        Which ones nobody can foretell. So a decoder that keeps pictures for later bitstreams is found out.
        """
        codec = alone() if self._chosen else self._codec
        for frame, digest in self._chosen:
            self._position.at("decode", frame)
            decoded = codec.decode(self._read(frame))
            if zlib.crc32(np.ascontiguousarray(decoded).data) != digest:
                raise CodingError(
                    "decode makes another picture of the same bytes in a process that has decoded nothing else; a "
                    "picture is decoded from its bitstream alone, or its codec is a StreamCodec"
                )

    def _around(self, frame: int, size_bytes: int) -> list[int]:
        """A frame and some of its neighbors in an order of chance."""
        count = batch_size(size_bytes)
        begin = frame // count * count
        frames = list(range(begin, min(begin + count, self._frames)))
        self._chance.shuffle(frames)
        return frames

    def _decode(self, left: list[int]) -> None:
        """Have these frames ready, or the errors of those that cannot be decoded."""
        bitstreams = {index: self._read(index) for index in left}
        while left:
            self._position.at("decode")
            pictures = self._codec.at_decoder(map_until_failure, "decode", [bitstreams[index] for index in left])
            self._ready |= zip(left, pictures, strict=False)
            if failed := left[len(pictures) :][:1]:
                self._position.at("decode", *failed)
                try:
                    self._ready[failed[0]] = self._codec.decode(bitstreams[failed[0]])
                except PluginLoss:
                    raise
                except CodecbenchError as error:
                    self._ready[failed[0]] = error
            left = left[len(pictures) + 1 :]


class CheckedDecoder:
    """A session of a codec that gives each frame of `owed` one picture, whole, or raises CodingError.

    given: the frames whose picture has come. Pictures of other frames, from before decoding started, are left out.
    """

    def __init__(self, codec: AnyCodec[Any], owed: Container[int]) -> None:
        self._decoder = codec.open_decoder()
        self._owed = owed
        self.given: set[int] = set()

    def push(self, packet: Packet, original: Image) -> dict[int, Image]:
        """The pictures that are ready after a packet, by frame. original: an image of their shape."""
        return self._checked(self._decoder.push(packet), original)

    def flush(self, original: Image) -> dict[int, Image]:
        """The pictures that were held back."""
        return self._checked(self._decoder.flush(), original)

    def _checked(self, pictures: object, original: Image) -> dict[int, Image]:
        if not isinstance(pictures, list):
            raise CodingError(f"the decoder returned {type(pictures).__name__}; it returns a list of Pictures")
        found: dict[int, Image] = {}
        for picture in pictures:
            if not isinstance(picture, Picture) or type(picture.frame) is not int:
                raise CodingError(f"the decoder returned a list with {type(picture).__name__}; it holds Pictures")
            frame = picture.frame
            if frame not in self._owed:
                continue
            if frame in self.given:
                raise CodingError(f"the decoder returned frame {frame} a second time")
            if picture.state != "whole":
                raise CodingError(f"the decoder says that frame {frame} is {picture.state}, though nothing was lost")
            self.given.add(frame)
            found[frame] = check_decoding(picture.image, original).copy()  # decoders go on writing into theirs
        return found


def check_decoding(decoded: object, original: Image) -> Image:
    """`decoded` as a contiguous image that can be written, after checking type, dtype and shape against the frame's."""
    if not isinstance(decoded, np.ndarray):
        raise CodingError(f"decode returned {type(decoded).__name__}; a decoded frame is a numpy array")
    image = np.ascontiguousarray(decoded)  # first, because what only claims to be an array may become another
    if image.dtype != np.uint8:
        raise CodingError(f"decode returned dtype {image.dtype}; a decoded frame is uint8")
    if image.shape != original.shape:
        raise CodingError(f"decode returned shape {image.shape}; the frame has {original.shape}")
    return image if image.flags.writeable else image.copy()  # kernels are compiled anew for arrays of another kind
