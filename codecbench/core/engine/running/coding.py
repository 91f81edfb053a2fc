"""Where frames become bitstreams and bitstreams become frames: the only position that calls a codec for its result.

Codecs are stateless, so frames are coded one by one. A codec with memory between frames (video) would change
`encode_sequence` and `CodedFrames` and nothing else.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.evaluator import CodedFrame
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Sequence
from codecbench.core.engine.storage.bitstream_file import BitstreamFile


class CodingError(CodecbenchError):
    """A codec returned something that is not a bitstream, or not the picture's shape."""


@dataclass
class WorkPosition:
    """Where in a sequence the work has got to, for the reason of a failure: `encode, frame 17`.

    titles: of the plugins of other distributions, by the stage at which their code runs.
    """

    stage: str = ""
    frame: int | None = None
    titles: Mapping[str, str] = field(default_factory=dict)
    process: int = field(default_factory=os.getpid)

    def at(self, stage: str, frame: int | None = None) -> None:
        self.stage, self.frame = stage, frame

    def came_back(self) -> None:
        """End this process where a codec forked and came back in it too: it would write what the first one writes."""
        if os.getpid() != self.process:
            os._exit(0)

    def __str__(self) -> str:
        place = self.stage if self.frame is None else f"{self.stage}, frame {self.frame}"
        return f"{self.titles[self.stage]}: {place}" if self.stage in self.titles else place


def encode_sequence(codec: Codec[Any], sequence: Sequence, position: WorkPosition) -> Iterator[bytes]:
    """The bitstreams of all frames in order. Raises CodingError for what is not a bitstream."""
    for index in range(len(sequence)):
        position.at("read", index)
        image = sequence.read(index).image
        position.at("encode", index)
        bitstream = codec.encode(image)
        position.came_back()
        if not isinstance(bitstream, bytes):
            raise CodingError(f"encode returned {type(bitstream).__name__}; a bitstream is bytes")
        content = memoryview(bitstream).tobytes()  # whatever a subclass of bytes says of itself
        if not content:
            raise CodingError("encode returned no bytes")
        yield content


class CodedFrames:
    """A CodedSequence over a file of bitstreams; frames are read and decoded when they are asked for.

    `codec` must be an instance that has encoded nothing, so that whatever it knows came from the bitstream.
    """

    def __init__(
        self, sequence: Sequence, codec: Codec[Any], bitstreams: BitstreamFile, position: WorkPosition
    ) -> None:
        if len(bitstreams) != len(sequence):
            raise CodingError(f"{len(bitstreams)} bitstreams for {len(sequence)} frames of {sequence.name}")
        self.sequence = sequence
        self.codec = codec
        self._bitstreams = bitstreams
        self._position = position

    def __len__(self) -> int:
        return len(self._bitstreams)

    def __iter__(self) -> Iterator[CodedFrame]:
        return (self.frame(index) for index in range(len(self)))

    def frame(self, index: int) -> CodedFrame:
        """Frame `index` beside its bitstream and what the codec makes of it.

        Raises BitstreamDamage for a damaged bitstream, CodingError for a result that is not an image of
        the frame's shape, and whatever the codec raises.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} is not one of 0..{len(self) - 1}")
        outer = self._position.stage
        self._position.at("read", index)
        original = self.sequence.read(index)
        bitstream = self._bitstreams.read(index)
        self._position.at("decode", index)
        decoded = checked_decoding(self.codec.decode(bitstream), original.image)
        self._position.came_back()
        self._position.at(outer, index)
        return CodedFrame(original, bitstream, decoded)

    def size_bytes(self, index: int) -> int:
        return self._bitstreams.size_bytes(index)


def checked_decoding(decoded: object, original: Image) -> Image:
    """`decoded` as a contiguous image that can be written, after checking type, dtype and shape against the frame's."""
    if not isinstance(decoded, np.ndarray):
        raise CodingError(f"decode returned {type(decoded).__name__}; a decoded frame is a numpy array")
    image = np.ascontiguousarray(decoded)  # first, because what only claims to be an array may become another
    if image.dtype != np.uint8:
        raise CodingError(f"decode returned dtype {image.dtype}; a decoded frame is uint8")
    if image.shape != original.shape:
        raise CodingError(f"decode returned shape {image.shape}; the frame has {original.shape}")
    return image if image.flags.writeable else image.copy()  # kernels are compiled anew for arrays of another kind
