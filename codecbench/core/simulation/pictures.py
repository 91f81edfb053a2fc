"""What a decoder makes of what came over a link."""

from __future__ import annotations

from dataclasses import replace

from codecbench.core.contracts.codec import decoder_of
from codecbench.core.contracts.evaluator import CodedSequence
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.stream import LOST, Picture, StreamDecoder
from codecbench.core.simulation.delivery import Delivery
from codecbench.core.simulation.partial import PartialDecoder


class DeliveredPictures:
    """Pictures by frame, asked in rising order.

    Of a stream in which something was concealed, or that was coded anew, a session decodes what came, and is told what
    did not: from the first loss on, nobody but the codec knows what its pictures look like.
    """

    def __init__(self, coded: CodedSequence, delivery: Delivery) -> None:
        self._coded, self._came, self._bitstreams = coded, delivery.came, delivery.bitstreams
        self._parts, self._partial = delivery.parts, PartialDecoder(coded, delivery.bitstreams)
        is_recoded = bool(delivery.bitstreams) and not coded.codec.stateless
        self._decoder = decoder_of(coded.codec) if is_recoded or "concealed" in delivery.outcomes else None
        self._is_over = False
        self._units = iter(delivery.units)
        self._session = 0
        self._frames: list[int] | None = [] if is_recoded else None
        self._given: dict[int, Image | None] = {}

    def picture(self, frame: int) -> Image | None:
        """The picture of a frame that was handed on; None where the decoder makes none."""
        if frame in self._parts:
            partial = self._partial.decode(frame, self._parts[frame].received.ranges)
            return None if partial is None else partial.image
        if frame in self._bitstreams and self._coded.codec.stateless:
            return self._coded.codec.decode(self._bitstreams[frame])
        if self._decoder is None:
            return self._coded.frame(frame).decoded
        while frame not in self._given and not self._is_over:
            self._given |= {shown: image for shown, image in self._next(self._decoder) if shown >= frame}
        return self._given.pop(frame, None)

    def _next(self, decoder: StreamDecoder) -> list[tuple[int, Image | None]]:
        """What the decoder gives for the next packet, or for the end of its session, by frame."""
        unit = next(self._units, None)
        self._is_over = unit is None
        if unit is None:
            return self._named(decoder.flush())
        before = []
        if unit.session != self._session:
            before = self._named(decoder.flush())
            decoder = self._decoder = decoder_of(self._coded.codec)
            self._session, self._frames = unit.session, []
        number = unit.frame
        if self._frames is not None:
            number = len(self._frames)
            self._frames.append(unit.frame)
        if not self._came[unit.frame]:
            return before + self._named(decoder.push(LOST))
        data = self._bitstreams.get(unit.frame) or self._coded.frame(unit.frame).bitstream
        return before + self._named(decoder.push(replace(unit, frame=number).packet(data)))

    def _named(self, pictures: list[Picture]) -> list[tuple[int, Image | None]]:
        """By the frames of the sequence; in a session that was coded anew they are numbered as they were pushed."""
        if self._frames is None:
            return [(picture.frame, picture.image) for picture in pictures]
        return [(self._frames[picture.frame], picture.image) for picture in pictures]
