"""Joining a stream in the middle: how many frames pass until pictures are those of who saw it from the beginning."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from codecbench.core.contracts.codec import AnyCodec, decoder_of
from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.evaluator import CodedSequence, SentPacket
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.stream import Packet, Picture
from codecbench.plugins.evaluators.quality.psnr import psnr_db


def joined_places(packets: int, joins: int) -> list[int]:
    """Up to `joins` places in the first half of the packets, the first excepted: one in each of equal parts.

    Drawn, so that they keep no step with starts at equal distances, and the same for all settings of a sequence. After
    each of them at least half of the sequence is left for pictures to become whole.
    """
    last = packets // 2
    bounds = np.linspace(1, last + 1, min(joins, last) + 1).round().astype(int)
    rng = np.random.default_rng(0)
    return [int(rng.integers(low, high)) for low, high in pairwise(bounds)]


def frames_until_whole(coded: CodedSequence, places: list[int], whole_db: float) -> list[float]:
    """For each place in the order of sending, the frames from that packet's to the first from which on all are whole.

    A picture is whole where its PSNR against the uninterrupted decoding is `whole_db` or more; infinity where the last
    of the sequence is not. Codecs without memory and those of features are whole from the next packet that starts.
    """
    if coded.codec.stateless or coded.codec.carries == "features":
        return [_until_start(coded.packets[place:]) for place in places]
    joiners = {place: _Joiner(coded.codec, coded.packets[place].frame) for place in places}
    for at, sent in enumerate(coded.packets):
        watching = [joiner for place, joiner in joiners.items() if place <= at]
        if watching:
            packet = sent.packet(coded.frame(sent.frame).bitstream)
            for joiner in watching:
                joiner.take(joiner.pictures(packet), coded, whole_db)
    for joiner in joiners.values():
        joiner.take(joiner.pictures(None), coded, whole_db)
    return [joiners[place].frames_until_whole(len(coded)) for place in places]


def _until_start(packets: Sequence[SentPacket]) -> float:
    """The frames from the first packet to one that starts."""
    return next((float(packet.frame - packets[0].frame) for packet in packets if packet.starts), math.inf)


class _Joiner:
    """Who decodes a stream from one packet on, that of frame `joined`, with nothing from before."""

    def __init__(self, codec: AnyCodec[Any], joined: int) -> None:
        self._decoder = decoder_of(codec)
        self._joined = joined
        self._whole: set[int] = set()

    def pictures(self, packet: Packet | None) -> list[Picture]:
        """What the packet, or the end of the stream, gives; a decoder may refuse what it cannot begin with."""
        try:
            return self._decoder.flush() if packet is None else self._decoder.push(packet)
        except BitstreamError:
            return []

    def take(self, pictures: list[Picture], coded: CodedSequence, whole_db: float) -> None:
        for picture in pictures:
            seen = picture.frame >= self._joined and picture.image is not None
            if seen and _alike(picture.image, coded.frame(picture.frame).decoded, whole_db):
                self._whole.add(picture.frame)

    def frames_until_whole(self, frames: int) -> float:
        """From the frame that was joined at; infinity where the last frame is not whole."""
        first = frames
        while first > self._joined and first - 1 in self._whole:
            first -= 1
        return math.inf if first == frames else float(first - self._joined)


def _alike(image: Image | None, uninterrupted: Image, whole_db: float) -> bool:
    if image is None or image.shape != uninterrupted.shape:
        return False
    return np.array_equal(image, uninterrupted) or psnr_db(uninterrupted, image) >= whole_db
