"""Sequences coded as features, in memory."""

from __future__ import annotations

from io import BytesIO

from bitstream_files import JOB
from memory_sequence import MemorySequence

from codecbench import FeatureCodec
from codecbench.core.conformance.material import pictures_with_corners
from codecbench.core.contracts.image import Layout
from codecbench.core.contracts.params import P
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.encoding import encode_sequence
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.storage.bitstream_file import BitstreamFile, write_stream

PICTURES = pictures_with_corners(Layout(1))[0].pictures


def coded_features(codec: FeatureCodec[P], sequence: FrameSequence | None = None) -> CodedFrames:
    """A sequence as a run codes it and reads it again; by default of PICTURES."""
    sequence, stream = sequence or MemorySequence(PICTURES), BytesIO()
    write_stream(stream, encode_sequence(codec, sequence, WorkPosition()), JOB)
    return CodedFrames(sequence, codec, BitstreamFile(stream.getvalue(), JOB), WorkPosition())
