"""What a decoder makes of what came over a link."""

from __future__ import annotations

from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.stream import LOST, Picture, StreamDecoder, decoder_of
from codecbench.core.simulation.delivery import Delivery
from codecbench.core.simulation.partial import PartialDecoder


class DeliveredPictures:
    """Pictures by frame, asked in rising order.

    Of a stream in which something was concealed, a session decodes what came, and is told what did not: from the first
    loss on, nobody but the codec knows what its pictures look like.
    """

    def __init__(self, coded: CodedSequence, delivery: Delivery) -> None:
        self._coded, self._came, self._bitstreams = coded, delivery.came, delivery.bitstreams
        self._parts, self._partial = delivery.parts, PartialDecoder(coded, delivery.bitstreams)
        self._decoder = decoder_of(coded.codec) if "concealed" in delivery.fates else None
        self._is_over = False
        self._units = iter(coded.packets)
        self._given: dict[int, Image | None] = {}

    def picture(self, frame: int) -> Image | None:
        """The picture of a frame that was handed on; None where the decoder makes none."""
        if frame in self._parts:
            found = self._partial.decode(frame, self._parts[frame].remains.ranges)
            return None if found is None else found.image
        if frame in self._bitstreams and isinstance(self._coded.codec, Codec):
            return self._coded.codec.decode(self._bitstreams[frame])
        if self._decoder is None:
            return self._coded.frame(frame).decoded
        while frame not in self._given:
            given = self._next(self._decoder)
            if given is None:
                return None
            self._given |= {picture.frame: picture.image for picture in given if picture.frame >= frame}
        return self._given.pop(frame)

    def _next(self, decoder: StreamDecoder) -> list[Picture] | None:
        """What the decoder gives for the next packet, or for the end; None after that."""
        if self._is_over:
            return None
        unit = next(self._units, None)
        if unit is None:
            self._is_over = True
            return decoder.flush()
        if not self._came[unit.frame]:
            return decoder.push(LOST)
        return decoder.push(unit.packet(self._coded.frame(unit.frame).bitstream))
