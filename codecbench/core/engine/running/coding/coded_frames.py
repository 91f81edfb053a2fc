"""A coded sequence as evaluators see it: frames beside their decoded versions, read and decoded on demand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from codecbench.core.contracts.codec import AnyCodec, sends_no_features, sends_no_picture
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import CodedFrame, CodedSequence, FrameSender, SentPacket
from codecbench.core.contracts.features import Features
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Frame, FrameSequence
from codecbench.core.engine.hosting.remote import RemoteCodec
from codecbench.core.engine.running.coding.decoding import (
    CheckedDecoder,
    SharedPictures,
    ShuffledPictures,
    StreamPictures,
    check_decoding,
)
from codecbench.core.engine.running.coding.encoding import CheckedEncoder
from codecbench.core.engine.running.coding.feature_decoding import StreamFeatures
from codecbench.core.engine.running.coding.position import CodingError, WorkPosition
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage, BitstreamFile, CodedPacket


class CodedFrames:
    """A CodedSequence over a bitstream file; frames are read and decoded on demand.

    `codec` must be an instance that has encoded nothing, so that all its knowledge comes from the bitstream. shared:
    pictures of this stream that were decoded before. Raises CodingError for a file with another number of frames, and
    BitstreamDamage for one of another kind of codec.
    """

    def __init__(
        self,
        sequence: FrameSequence,
        codec: AnyCodec[Any],
        bitstreams: BitstreamFile,
        position: WorkPosition,
        shared: SharedPictures | None = None,
    ) -> None:
        if len(bitstreams) != len(sequence):
            raise CodingError(f"{len(bitstreams)} bitstreams for {len(sequence)} frames of {sequence.name}")
        if bitstreams.is_stream == codec.stateless:
            kind = "a stream" if bitstreams.is_stream else "single frames"
            raise BitstreamDamage(f"the file contains {kind}, which {codec.name} no longer writes")
        self.sequence = sequence
        self.codec = codec
        self._bitstreams = bitstreams
        self._position = position
        self._stream = (
            StreamPictures(codec, bitstreams.packets, bitstreams.read, position, shared=shared)
            if codec.carries == "pictures" and not codec.stateless
            else None
        )
        self._shuffled = (
            ShuffledPictures(codec, bitstreams.read, len(sequence), position)
            if codec.stateless and isinstance(codec, RemoteCodec)
            else None
        )
        self._features = (
            StreamFeatures(codec, bitstreams.packets, bitstreams.read, position)
            if codec.carries == "features"
            else None
        )

    @property
    def packets(self) -> tuple[SentPacket, ...]:
        return self._bitstreams.packets

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the setting: whether its encoder holds frames back."""
        delay_frames = max(packet.after - packet.frame - 1 for packet in self.packets)
        if not delay_frames:
            return ()
        delay_ms = 1e3 * delay_frames / self.sequence.frame_rate_hz
        return (f"holds back {delay_frames} frame{'s' if delay_frames > 1 else ''} ({delay_ms:.0f} ms)",)

    def __len__(self) -> int:
        return len(self._bitstreams)

    def __iter__(self) -> Iterator[CodedFrame]:
        return (self.frame(index) for index in range(len(self)))

    def frame(self, index: int) -> CodedFrame:
        """Return frame `index` with its bitstream and its decoded version.

        Raises BitstreamDamage for a damaged bitstream, CodingError for a result that is not an image of the frame's
        shape, Unsupported for a codec of features, and whatever the codec raises.
        """
        self._require(index)
        if self._features is not None:
            raise sends_no_picture(self.codec)
        outer_stage = self._position.stage
        self._position.at("read", index)
        original = self.sequence.read(index)
        bitstream = self._bitstreams.read(index)
        self._position.at("decode", index)
        decoded = self._decode(index, bitstream, original.image)
        self._position.at(outer_stage, index)
        return CodedFrame(original, bitstream, decoded)

    def features(self, index: int) -> Features:
        """Return the decoded features of frame `index`.

        Raises as `frame` does, CodingError for a missing set, and Unsupported for a codec of pictures.
        """
        self._require(index)
        if self._features is None:
            raise sends_no_features(self.codec)
        outer_stage = self._position.stage
        features = self._features.features(index)
        self._position.at(outer_stage, index)
        return features

    def check(self, alone: Callable[[], AnyCodec[Any]]) -> None:
        """Raise CodingError if frames of an intra-only codec decode differently on their own.

        alone: returns the codec in a process that has decoded nothing; for codecs of other distributions.
        """
        if self._shuffled is not None:
            self._shuffled.check(alone)

    def size_bytes(self, index: int) -> int:
        return self._bitstreams.size_bytes(index)

    def sender(self) -> FrameSender:
        if self._features is not None:
            raise sends_no_picture(self.codec)
        if self._stream is not None:
            return LiveSender(self.codec, self.sequence, self._position)
        return StoredSender(self)

    def _require(self, index: int) -> None:
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} is not one of 0..{len(self) - 1}")

    def _decode(self, index: int, bitstream: bytes, original: Image) -> Image:
        if self._stream is not None:
            return self._stream.picture(index, original)
        if self._shuffled is not None:
            return self._shuffled.picture(index, original)
        return check_decoding(self.codec.decode(bitstream), original)


class StoredSender:
    """Sends frames of an intra-only codec: each is the same as in the whole sequence, in any order."""

    def __init__(self, coded: CodedSequence) -> None:
        self._coded = coded

    def send(self, index: int) -> CodedFrame:
        return self._coded.frame(index)


class LiveSender:
    """Sends frames through sessions of its own, so that the chosen frames alone make the stream.

    Its frame rate is the sequence's, whatever the distance of the chosen frames.
    """

    def __init__(self, codec: AnyCodec[Any], sequence: FrameSequence, position: WorkPosition) -> None:
        self._codec, self._sequence, self._position = codec, sequence, position
        self._encoder = CheckedEncoder(codec, sequence.frame_rate_hz)
        self._decoder = CheckedDecoder(codec, range(len(sequence)))
        self._places: dict[int, int] = {}
        self._packets: list[CodedPacket] = []

    def send(self, index: int) -> CodedFrame:
        """Send a frame and return it decoded. A frame that was sent before is decoded again, not sent twice.

        Raises Unsupported if the encoder or decoder holds it back, or if a later frame was sent before.
        """
        outer_stage = self._position.stage
        self._position.at("read", index)
        original = self._sequence.read(index)
        decoded = self._decode_again(index, original.image) if index in self._places else self._send_new(original)
        self._position.at(outer_stage, index)
        return CodedFrame(original, self._packets[self._places[index]].data, decoded)

    def _send_new(self, original: Frame) -> Image:
        index, place = original.index, len(self._packets)
        if self._places and index < (last_frame := next(reversed(self._places))):
            raise Unsupported(f"frame {index} cannot be sent after frame {last_frame}: a stream is sent in order")
        self._position.at("encode", index)
        packets = self._encoder.push(original.image)
        if not packets:
            raise Unsupported(
                f"{self._codec.name} holds frames back at this setting; a chosen frame must be sent at once"
            )
        self._places[index] = place
        self._packets += packets
        self._position.at("decode", index)
        (packet,) = packets
        pictures = self._decoder.push(replace(packet.sent_packet, frame=place).packet(packet.data), original.image)
        if place not in pictures:
            raise Unsupported(
                f"the decoder of {self._codec.name} holds frames back; a chosen frame must be decoded at once"
            )
        return pictures[place]

    def _decode_again(self, index: int, original: Image) -> Image:
        """Decode the picture of a frame that was sent before from what was sent."""
        sent_packets = [packet.sent_packet for packet in self._packets]
        pictures = StreamPictures(self._codec, sent_packets, lambda frame: self._packets[frame].data, self._position)
        return pictures.picture(self._places[index], original)
