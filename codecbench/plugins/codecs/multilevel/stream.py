"""The multi-level codec as a stream, whose one memory is the table of codes and how often each occurred."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from pydantic import Field

from codecbench.core.contracts.codec import Capabilities, StreamCodec
from codecbench.core.contracts.errors import ImageError
from codecbench.core.contracts.image import Image, check_image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Loss, Packet, Picture, StreamDecoder, StreamEncoder
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.dct.planes import Color
from codecbench.plugins.codecs.multilevel.codec import Multilevel, image_from_values
from codecbench.plugins.codecs.multilevel.header import MAX_GROUP, MAX_QF, MIN_GROUP, MIN_QF
from codecbench.plugins.codecs.multilevel.keys import canonical_keys, checked
from codecbench.plugins.codecs.multilevel.levels import expanded, minimised
from codecbench.plugins.codecs.multilevel.memory import Memory
from codecbench.plugins.codecs.multilevel.scan import Scan


class MultilevelStreamParams(Params):
    """Those of `multilevel` for one level with canonical keys and tuples that are sent, and how far memory goes."""

    qf: float = Field(5.0, ge=MIN_QF, le=MAX_QF, description="factor on the quantisation table")
    group: int = Field(3, ge=MIN_GROUP, le=MAX_GROUP, description="digits that become one code")
    color: Color = Field("rgb", description="planes of a colour image; a gray image is always one plane")
    scan: Scan = Field("block", description="coefficients block by block, or frequency by frequency")
    gop: int = Field(30, ge=1, le=1000, description="pictures from start to start")


class MultilevelStream(StreamCodec[MultilevelStreamParams]):
    """`multilevel` with a memory: its pictures, bit by bit, and tables that build on the one before.

    Nothing is predicted but the table, so the difference in size from `multilevel` is what memory alone is worth.
    """

    name: ClassVar[str] = "multilevel_stream"
    version: ClassVar[str] = "1"
    params_type = MultilevelStreamParams
    capabilities: ClassVar[Capabilities] = Capabilities()
    kernels: tuple[str, ...] = Multilevel.kernels
    examples = ({}, {"qf": 20, "color": "ycbcr420", "gop": 5}, {"qf": 75, "group": 2, "scan": "coefficient"})

    def __init__(self, params: MultilevelStreamParams) -> None:
        super().__init__(params)
        self.kernels = (*_still(params).kernels, "codecbench.plugins.codecs.multilevel.tables")

    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return MultilevelEncoder(self.params)

    def decoder(self) -> StreamDecoder:
        return MultilevelDecoder()


def _still(params: MultilevelStreamParams) -> Multilevel:
    """The codec of pictures that depend on no other."""
    return Multilevel.create(**params.model_dump(exclude={"gop"}))


class MultilevelEncoder(StreamEncoder):
    """One sequence being encoded."""

    def __init__(self, params: MultilevelStreamParams) -> None:
        self._gop, self._group = params.gop, params.group
        self._still = _still(params)
        self._memory: Memory | None = None
        self._shape: tuple[int, ...] = ()
        self._pushed = 0

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        image = check_image(image)
        if self._memory is not None and image.shape != self._shape:
            raise ImageError(f"a picture of shape {image.shape} in a stream of shape {self._shape}")
        frame = self._pushed
        if self._memory is None or frame % self._gop == 0:
            data = self._still.encode(image)
            self._memory, self._shape = Memory.after_start(data), image.shape
        else:
            data = self._coded_from(self._memory, image)
        self._pushed += 1
        return [Packet(data, frame, starts=frame % self._gop == 0)]

    def flush(self) -> list[Packet]:
        return []

    def _coded_from(self, memory: Memory, image: Image) -> bytes:
        values = self._still.values_of(image, memory.header, NULL_TRACE)
        found = minimised(
            values, 1, lambda level, radix: checked(canonical_keys(radix, self._group), radix, level), NULL_TRACE
        )
        (table,) = found.tables
        tuples = table.tuples + np.int32(found.offset)
        data = memory.encoded(tuples, table.counts, found.ranks, found.offset, table.radix)
        self._memory = memory.followed_by(tuples, table.counts, data)
        return data


class MultilevelDecoder(StreamDecoder):
    """One stream being decoded: pictures are whole, or missing from a loss to the next start."""

    def __init__(self) -> None:
        self._still = Multilevel.create()
        self._memory: Memory | None = None
        self._next = 0

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        frame = self._next if isinstance(packet, Loss) else packet.frame
        self._next = frame + 1
        memory, self._memory = self._memory, None  # what raises, or is lost, leaves none
        if isinstance(packet, Loss):
            return [Picture(frame, "missing", None)]
        if packet.starts:
            self._memory = Memory.after_start(packet.data)
            return [Picture(frame, "whole", self._still.decode(packet.data))]
        if memory is None:
            return [Picture(frame, "missing", None)]
        self._memory, ranks = memory.decoded(packet.data)
        header = memory.header
        values = expanded(ranks, [self._memory.tuples], 0, header.samples, NULL_TRACE)
        return [Picture(frame, "whole", image_from_values(values, header, NULL_TRACE))]

    def flush(self) -> list[Picture]:
        return []
