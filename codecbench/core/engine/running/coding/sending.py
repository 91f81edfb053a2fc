"""Senders: frames of a sequence that are chosen one by one, each coded after those that were sent before."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.evaluator import CodedFrame, CodedSequence
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Frame, FrameSequence
from codecbench.core.engine.running.coding.decoding import CheckedDecoder, StreamPictures
from codecbench.core.engine.running.coding.encoding import CheckedEncoder
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.storage.bitstream_file import CodedPacket


class StoredSender:
    """Sends frames of a codec without memory: they are what they are in the whole sequence, in any order."""

    def __init__(self, coded: CodedSequence) -> None:
        self._coded = coded

    def send(self, index: int) -> CodedFrame:
        return self._coded.frame(index)


class LiveSender:
    """Sends frames through sessions of their own, so that the chosen frames alone make the stream.

    Its frame rate is the sequence's, whatever the distance of the chosen frames.
    """

    def __init__(self, codec: AnyCodec[Any], sequence: FrameSequence, position: WorkPosition) -> None:
        self._codec, self._sequence, self._position = codec, sequence, position
        self._encoder = CheckedEncoder(codec, sequence.frame_rate_hz)
        self._decoder = CheckedDecoder(codec, range(len(sequence)))
        self._places: dict[int, int] = {}
        self._packets: list[CodedPacket] = []

    def send(self, index: int) -> CodedFrame:
        """The frame, which its decoder has at once. One that was sent before is given again and not sent twice.

        Raises Unsupported where the encoder or the decoder holds it back, and where a later frame was sent before.
        """
        outer = self._position.stage
        self._position.at("read", index)
        original = self._sequence.read(index)
        decoded = self._again(index, original.image) if index in self._places else self._sent(original)
        self._position.at(outer, index)
        return CodedFrame(original, self._packets[self._places[index]].data, decoded)

    def _sent(self, original: Frame) -> Image:
        index, place = original.index, len(self._packets)
        if self._places and index < (last := next(reversed(self._places))):
            raise Unsupported(f"frame {index} is to be sent after frame {last}, and a stream does not go back")
        self._position.at("encode", index)
        packets = self._encoder.push(original.image)
        if not packets:
            raise Unsupported(
                f"{self._codec.name} holds frames back with this setting; a chosen frame must be sent at once"
            )
        self._places[index] = place
        self._packets += packets
        self._position.at("decode", index)
        (packet,) = packets
        pictures = self._decoder.push(replace(packet.sent, frame=place).packet(packet.data), original.image)
        if place not in pictures:
            raise Unsupported(
                f"the decoder of {self._codec.name} holds frames back; a chosen frame must be seen at once"
            )
        return pictures[place]

    def _again(self, index: int, original: Image) -> Image:
        """The picture of a frame that was sent before, decoded from what was sent."""
        told = [packet.sent for packet in self._packets]
        pictures = StreamPictures(self._codec, told, lambda frame: self._packets[frame].data, self._position)
        return pictures.picture(self._places[index], original)
