"""Encode a sequence: push frames into a session in order, and check what comes out."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from codecbench.core.contracts.codec import AnyCodec, encoder_of
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.contracts.stream import Packet, is_recovery
from codecbench.core.engine.hosting.remote import RemoteCodec
from codecbench.core.engine.running.coding.decoding import batch_size, map_until_failure
from codecbench.core.engine.running.coding.position import WRITE, CodingError, WorkPosition
from codecbench.core.engine.storage.bitstream_file import CodedPacket


def encode_sequence(codec: AnyCodec[Any], sequence: FrameSequence, position: WorkPosition) -> Iterator[CodedPacket]:
    """Yield the packets of all frames in sending order; the position is `write` while the caller handles one.

    Raises CodingError for something that is not a packet, and if a frame has none or two.
    """
    position.at("encode")
    encoder = CheckedEncoder(codec, sequence.frame_rate_hz)
    is_hosted = codec.stateless and isinstance(codec, RemoteCodec)
    images: dict[int, Image] = {}
    for index in range(len(sequence)):
        if index not in images:
            images, encoded_ahead = _read(sequence, index, position, alone=not is_hosted), {}
            if is_hosted:
                position.at("encode", index if len(images) == 1 else None)
                encoded_ahead = dict(
                    enumerate(codec.at_encoder(map_until_failure, "encode", [*images.values()]), index)
                )
        position.at("encode", index)
        packets = encoder.push(images[index], encoded_ahead.get(index))
        position.at(WRITE, index)
        yield from packets
    position.at("encode")
    packets = encoder.flush()
    position.at(WRITE)
    yield from packets


def _read(sequence: FrameSequence, begin: int, position: WorkPosition, *, alone: bool) -> dict[int, Image]:
    """Read a frame and, unless `alone`, those that go to a host together with it; return images by index."""
    images: dict[int, Image] = {}
    for index in range(begin, len(sequence)):
        position.at("read", index)
        images[index] = sequence.read(index).image
        if alone or len(images) == batch_size(images[begin].nbytes):
            break
    return images


class CheckedEncoder:
    """A session of a codec that returns exactly one packet per frame, or raises CodingError."""

    def __init__(self, codec: AnyCodec[Any], frame_rate_hz: float) -> None:
        self._encoder = encoder_of(codec, frame_rate_hz)
        self._gives_packets = not codec.stateless
        self._pushed = 0
        self._sent: set[int] = set()

    def push(self, image: Image, bitstream: Any = None) -> list[CodedPacket]:
        """Return the packets after this image. bitstream: of an intra-only codec, if already encoded."""
        packets = self._encoder.push(image) if bitstream is None else [Packet(bitstream, self._pushed, starts=True)]
        self._pushed += 1
        return self._check_packets(packets, "push")

    def flush(self) -> list[CodedPacket]:
        packets = self._check_packets(self._encoder.flush(), "flush")
        if missing := sorted(set(range(self._pushed)) - self._sent):
            shown = ", ".join(map(str, missing[:5])) + (", ..." if len(missing) > 5 else "")
            raise CodingError(f"{len(missing)} of {self._pushed} frames have no packet after flush: {shown}")
        return packets

    def _check_packets(self, packets: object, call: str) -> list[CodedPacket]:
        if not isinstance(packets, list):
            raise CodingError(f"{call} returned {type(packets).__name__}; it must return a list of Packets")
        return [self._check_packet(packet, call) for packet in packets]

    def _check_packet(self, packet: object, call: str) -> CodedPacket:
        if not isinstance(packet, Packet):
            raise CodingError(f"{call} returned a list with {type(packet).__name__}; all must be Packets")
        frame, starts = packet.frame, packet.starts
        if type(frame) is not int or type(starts) is not bool:
            kinds = f"{type(frame).__name__} and {type(starts).__name__}"
            raise CodingError(f"{call} returned a packet whose frame and starts are {kinds}; they must be int and bool")
        if not is_recovery(packet.recovery_frames):
            got = repr(packet.recovery_frames)[:40]
            raise CodingError(f"{call} returned a packet with recovery_frames {got}; it must be None or a frame count")
        if not 0 <= frame < self._pushed:
            raise CodingError(f"{call} returned a packet of frame {frame}; 0 to {self._pushed - 1} were pushed")
        if frame in self._sent:
            raise CodingError(f"{call} returned a packet of frame {frame} a second time")
        if not self._sent and not starts:
            raise CodingError(f"the first packet, of frame {frame}, has starts=False: decoding could never begin")
        self._sent.add(frame)
        return CodedPacket(self._content(packet), frame, starts, self._pushed, packet.recovery_frames)

    def _content(self, packet: Packet) -> bytes:
        returned = f"the packet of frame {packet.frame} contains" if self._gives_packets else "encode returned"
        if not isinstance(packet.data, bytes):
            raise CodingError(f"{returned} {type(packet.data).__name__}; a bitstream is bytes")
        data = memoryview(packet.data).tobytes()  # a subclass of bytes may override everything else
        if not data:
            raise CodingError(f"{returned} no bytes")
        return data
