"""Decode a stream: push packets into a session in order, and access pictures by frame."""

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

_BATCH_FRAMES: Final = range(4, 9)
_BATCH_BYTES: Final = 4 << 20
_RECHECKED_FRAMES: Final = 4
CACHED_BYTES: Final = 64 << 20
"""Limit of cached decoded pictures for small steps back: 72 color frames of 640x480."""


def batch_size(size_bytes: int) -> int:
    """Return how many frames of this size go to or from a host at once, which saves waiting and memory pages."""
    return min(max(_BATCH_BYTES // size_bytes, _BATCH_FRAMES.start), _BATCH_FRAMES.stop - 1)


def map_until_failure(codec: AnyCodec[Any], method: str, inputs: list[Any]) -> list[Any]:
    """Call `encode` on images, or `decode` on bitstreams, until one fails; return the results before it.

    This runs in the codec's process, because passing items singly can take as long as coding them.
    """
    results: list[Any] = []
    with suppress(BaseException):  # the caller repeats the failing call to get its error
        results.extend(map(getattr(codec, method), inputs))
    return results


class StreamPictures:
    """The pictures of a stream by frame, in any order.

    In-order access decodes each packet once, because the session stays open. After a jump, decoding restarts at the
    last packet at which it can. The pictures decoded last are cached, up to `kept_bytes`.

    packets: in sending order. read: returns the bytes of a frame's packet. shared: pictures of this stream that were
    decoded before, by frame; new ones are added to it.
    """

    def __init__(
        self,
        codec: AnyCodec[Any],
        packets: Sequence[SentPacket],
        read: Callable[[int], bytes],
        position: WorkPosition,
        kept_bytes: int = CACHED_BYTES,
        shared: SharedPictures | None = None,
    ) -> None:
        self._codec, self._packets, self._read, self._position = codec, packets, read, position
        self._places = {packet.frame: place for place, packet in enumerate(packets)}
        self._starts = [place for place, packet in enumerate(packets) if packet.starts]
        self._cached: dict[int, Image] = {}
        self._free_bytes = kept_bytes
        self._shared = SharedPictures(0) if shared is None else shared
        self._decoder: CheckedDecoder | None = None
        self._session_start = self._next = 0

    def picture(self, frame: int, original: Image) -> Image:
        """Return the picture of a frame, which the caller may change.

        Raises CodingError if the codec returns none, or one that is not whole or not of the original's shape.
        """
        image = self._cached.get(frame)
        if image is None:
            image = self._shared.get(frame)
        return (self._decode_until(frame, original) if image is None else image).copy()

    def _decode_until(self, frame: int, original: Image) -> Image:
        decoder = self._decoder_for(frame)
        self._decoder = None  # not reused if it raises
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
            raise CodingError("the decoder returned no frame after all packets and flush")
        return pictures[frame]

    def _decoder_for(self, frame: int) -> CheckedDecoder:
        """Return the open session if it will reach this frame, otherwise a new one."""
        start = self._start_of(frame)
        decoder = self._decoder
        if decoder is not None and frame not in decoder.decoded_frames and self._session_start <= start <= self._next:
            return decoder
        self._session_start = self._next = start
        expected = {packet.frame for packet in self._packets[start:] if self._start_of(packet.frame) >= start}
        return CheckedDecoder(self._codec, expected)

    def _start_of(self, frame: int) -> int:
        """Return the index of the last packet at which decoding can start to get this frame.

        If encoders reorder, frames before a keyframe may follow it and need earlier packets.
        """
        index = bisect_right(self._starts, self._places[frame]) - 1
        while index > 0 and self._packets[self._starts[index]].frame > frame:
            index -= 1
        return self._starts[index]

    def _keep(self, pictures: Mapping[int, Image]) -> None:
        for frame, image in pictures.items():
            self._cached[frame] = image
            self._shared.keep(frame, image)
            self._free_bytes -= image.nbytes
        while self._free_bytes < 0:
            self._free_bytes += self._cached.pop(next(iter(self._cached))).nbytes


class SharedPictures:
    """Pictures of the stream that this process decoded last, so that its next evaluator need not decode them again.

    A stream is read front to back repeatedly, so what does not fit into `limit_bytes` is not stored.
    """

    def __init__(self, limit_bytes: int) -> None:
        self._limit_bytes = limit_bytes
        self._used_bytes = 0
        self._stream = b""
        self._pictures: dict[int, Image] = {}

    def of(self, stream: bytes, limit_bytes: int) -> SharedPictures:
        """Return this object, emptied if it had pictures of a stream with another digest."""
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
    """Pictures of another distribution's intra-only codec, decoded in an order that it cannot predict.

    Frames are decoded before they are requested, in batches of neighbors; an error is raised when its frame is
    requested. read: returns the bytes of a frame.
    """

    def __init__(self, codec: AnyCodec[Any], read: Callable[[int], bytes], frames: int, position: WorkPosition) -> None:
        self._codec, self._read, self._frames, self._position = codec, read, frames, position
        self._ready: dict[int, Any] = {}
        self._requested: set[int] = set()
        self._sample: list[tuple[int, int]] = []
        """Frames that were asked for, with digests of their pictures, to be decoded once more in the end."""
        self._chance = random.SystemRandom()

    def picture(self, frame: int, original: Image) -> Image:
        """Return the picture of a frame. Raises CodingError if it is no image of the original's shape."""
        if frame not in self._ready:
            if frame in self._requested:  # stepping back keeps the frames decoded ahead
                self._decode([frame])
            else:
                self._ready = {}
                self._decode(self._around(frame, original.nbytes))
        result = self._ready.pop(frame)
        self._position.at("decode", frame)
        if isinstance(result, BaseException):
            raise result
        image = check_decoding(result, original)
        if frame not in self._requested:
            self._requested.add(frame)
            place = (
                len(self._sample)
                if len(self._sample) < _RECHECKED_FRAMES
                else self._chance.randrange(len(self._requested))
            )
            if place < _RECHECKED_FRAMES:  # reservoir sampling: all frames so far are equally likely
                self._sample[place:] = [(frame, zlib.crc32(image.data)), *self._sample[place + 1 :]]
        return image

    def check(self, alone: Callable[[], AnyCodec[Any]]) -> None:
        """Decode an unpredictable sample of frames again with `alone()`, in a process of its own, and compare.

        Raises CodingError if a picture differs. This detects a decoder that keeps pictures for later bitstreams.
        """
        codec = alone() if self._sample else self._codec
        for frame, digest in self._sample:
            self._position.at("decode", frame)
            decoded = codec.decode(self._read(frame))
            if zlib.crc32(np.ascontiguousarray(decoded).data) != digest:
                raise CodingError(
                    "decode returns other pixels for the same bitstream in a new process; decode each frame from its "
                    "bitstream alone, or make the codec a StreamCodec"
                )

    def _around(self, frame: int, size_bytes: int) -> list[int]:
        """Return a frame and some of its neighbors in random order."""
        count = batch_size(size_bytes)
        begin = frame // count * count
        frames = list(range(begin, min(begin + count, self._frames)))
        self._chance.shuffle(frames)
        return frames

    def _decode(self, remaining: list[int]) -> None:
        """Decode these frames; store the error of each one that fails."""
        bitstreams = {index: self._read(index) for index in remaining}
        while remaining:
            self._position.at("decode")
            pictures = self._codec.at_decoder(map_until_failure, "decode", [bitstreams[index] for index in remaining])
            self._ready |= zip(remaining, pictures, strict=False)
            if failed_frames := remaining[len(pictures) :][:1]:
                self._position.at("decode", *failed_frames)
                try:
                    self._ready[failed_frames[0]] = self._codec.decode(bitstreams[failed_frames[0]])
                except PluginLoss:
                    raise
                except CodecbenchError as error:
                    self._ready[failed_frames[0]] = error
            remaining = remaining[len(pictures) + 1 :]


class CheckedDecoder:
    """A session of a codec that returns exactly one whole picture for each frame of `expected`, or raises CodingError.

    decoded_frames: frames whose picture has come. Pictures of other frames, from before decoding started, are dropped.
    """

    def __init__(self, codec: AnyCodec[Any], expected: Container[int]) -> None:
        self._decoder = codec.open_decoder()
        self._expected = expected
        self.decoded_frames: set[int] = set()

    def push(self, packet: Packet, original: Image) -> dict[int, Image]:
        """Return the pictures that are ready after a packet, by frame. original: an image of their shape."""
        return self._check_pictures(self._decoder.push(packet), original)

    def flush(self, original: Image) -> dict[int, Image]:
        """Return the pictures that were held back."""
        return self._check_pictures(self._decoder.flush(), original)

    def _check_pictures(self, pictures: object, original: Image) -> dict[int, Image]:
        if not isinstance(pictures, list):
            raise CodingError(f"the decoder returned {type(pictures).__name__}; it must return a list of Pictures")
        images: dict[int, Image] = {}
        for picture in pictures:
            if not isinstance(picture, Picture) or type(picture.frame) is not int:
                raise CodingError(f"the decoder returned a list with {type(picture).__name__}; all must be Pictures")
            frame = picture.frame
            if frame not in self._expected:
                continue
            if frame in self.decoded_frames:
                raise CodingError(f"the decoder returned frame {frame} a second time")
            if picture.state != "whole":
                raise CodingError(f"the decoder returned frame {frame} as {picture.state}, but nothing was lost")
            self.decoded_frames.add(frame)
            images[frame] = check_decoding(picture.image, original).copy()  # decoders reuse their buffers
        return images


def check_decoding(decoded: object, original: Image) -> Image:
    """Return a contiguous writable image after checking its type, dtype and shape against the frame's."""
    if not isinstance(decoded, np.ndarray):
        raise CodingError(f"decode returned {type(decoded).__name__}; a decoded frame is a numpy array")
    image = np.ascontiguousarray(decoded)  # first, because an array subclass may change here
    if image.dtype != original.dtype:
        raise CodingError(f"decode returned dtype {image.dtype}; the frame has {original.dtype}")
    if image.shape != original.shape:
        raise CodingError(f"decode returned shape {image.shape}; the frame has {original.shape}")
    return image if image.flags.writeable else image.copy()  # numba recompiles for read-only arrays
