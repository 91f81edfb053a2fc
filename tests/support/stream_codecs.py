"""Codecs with memory whose every answer is known, for tests of the engine."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

from codecbench import (
    NULL_TRACE,
    Capabilities,
    Image,
    Loss,
    NoParams,
    Packet,
    Params,
    Picture,
    StreamCodec,
    StreamDecoder,
    StreamEncoder,
    Trace,
)

SHAPE = (8, 16)


class AnchorParams(Params):
    anchors: int = 3
    """From one start to the next."""


class Reordered(StreamCodec[AnchorParams]):
    """Gray frames of SHAPE. Even frames are anchors; odd ones are sent after the next anchor and need both neighbours,
    also where that anchor starts: an open group of pictures."""

    name = "reordered"
    version = "1"
    params_type = AnchorParams
    capabilities = Capabilities(channels=(1,), lossless=True)

    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return _ReorderingEncoder(self.params.anchors)

    def decoder(self) -> StreamDecoder:
        return _ReorderedDecoder()

    def is_low_delay(self) -> bool:
        return False


class _ReorderingEncoder(StreamEncoder):
    def __init__(self, anchors: int) -> None:
        self.every, self.pushed = anchors, 0
        self.anchor: Image | None = None
        self.waiting: Image | None = None

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        frame, self.pushed = self.pushed, self.pushed + 1
        if frame % 2:
            self.waiting = image.copy()
            return []
        return self._anchored(image, frame, starts=frame // 2 % self.every == 0)

    def flush(self) -> list[Packet]:
        if self.waiting is None:
            return []
        image, self.waiting = self.waiting, None
        return self._anchored(image, self.pushed - 1, starts=False)

    def _anchored(self, image: Image, frame: int, *, starts: bool) -> list[Packet]:
        before, self.anchor = self.anchor, image.copy()
        change = image if starts or before is None else image - before
        packets = [Packet((b"S" if starts else b"P") + zlib.compress(change.tobytes()), frame, starts)]
        if self.waiting is not None and before is not None:
            between, self.waiting = self.waiting - before - image, None
            packets.append(Packet(b"B" + zlib.compress(between.tobytes()), frame - 1, starts=False))
        return packets


class _ReorderedDecoder(StreamDecoder):
    def __init__(self) -> None:
        self.anchors: list[Image] = []
        self.pending: Picture | None = None

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        assert not isinstance(packet, Loss)
        kind, samples = packet.data[:1], np.frombuffer(zlib.decompress(packet.data[1:]), np.uint8).reshape(SHAPE)
        if kind == b"B":
            known = len(self.anchors) == 2
            image = samples + self.anchors[0] + self.anchors[1] if known else None
            between = Picture(packet.frame, "whole" if known else "missing", image)
            return [between, *self.flush()]
        image = samples if kind == b"S" else samples + self.anchors[-1]
        ready = self.flush()
        self.anchors = [*self.anchors[-1:], image]
        self.pending = Picture(packet.frame, "whole", image)
        return ready

    def flush(self) -> list[Picture]:
        ready, self.pending = [self.pending] if self.pending else [], None
        return ready


class Scripted(StreamCodec[NoParams]):
    """Does what two functions say: packets from the number of the push (-1 at flush), pictures from a packet."""

    name = "scripted"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities(channels=(1,))

    def __init__(self, packets: Callable[[int], Any], pictures: Callable[[Packet], Any] = lambda packet: []) -> None:
        super().__init__(NoParams())
        self.packets, self.pictures = packets, pictures

    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return _ScriptedEncoder(self.packets)

    def decoder(self) -> StreamDecoder:
        return _ScriptedDecoder(self.pictures)


class _ScriptedEncoder(StreamEncoder):
    def __init__(self, packets: Callable[[int], Any]) -> None:
        self.packets, self.pushed = packets, 0

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> Any:
        self.pushed += 1
        return self.packets(self.pushed - 1)

    def flush(self) -> Any:
        return self.packets(-1)


class _ScriptedDecoder(StreamDecoder):
    def __init__(self, pictures: Callable[[Packet], Any]) -> None:
        self.pictures = pictures

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> Any:
        assert not isinstance(packet, Loss)
        return self.pictures(packet)

    def flush(self) -> list[Picture]:
        return []
